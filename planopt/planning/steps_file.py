"""``steps.csv``: a row for every place of a plan or run, numbers to the last digit."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.plan import Plan
from planopt.planning.run import StepLog
from planopt.planning.solution_json import LARGEST, REMEDY, finite_list

STEPS_FILE = "steps.csv"

NUMBER_COLUMNS = ("t_s", "x_m", "y_m", "predicted_db", "deviation_db", "connectivity", "true_db")
LABEL_COLUMNS = ("connected", "rung", "verdict")
COLUMNS = ("robot", "step", *NUMBER_COLUMNS, *LABEL_COLUMNS)
"""The columns (design, section 3)."""
REQUIRED_NUMBERS = ("t_s", "x_m", "y_m")


@dataclass(frozen=True, eq=False)
class Steps:
    """The table by columns.

    Attributes
    ----------
    robots
        Whose rows they are, row by row.
    numbers
        `NUMBER_COLUMNS` by name, NaN where a cell is empty; ``(n,)`` each.
    labels
        `LABEL_COLUMNS` by name.
    """

    robots: tuple[str, ...]
    numbers: dict[str, NDArray[np.float64]]
    labels: dict[str, tuple[str, ...]]

    @property
    def positions_m(self) -> NDArray[np.float64]:
        """``(n, 2)``."""
        return np.stack([self.numbers["x_m"], self.numbers["y_m"]], axis=1)


def steps_of_plan(plan: Plan) -> Steps:
    """The table of a plan; what the truth is there, nobody knows."""
    count = len(plan.t_s)
    columns = (
        plan.t_s,
        *plan.positions_m.T,
        plan.mean_dbm,
        plan.deviation_db,
        plan.connectivity,
        np.full(count, np.nan),
    )
    labels = ([""] * count, [plan.rung.value] * count, [plan.verdict.value] * count)
    return _steps(plan.robot, columns, labels)


def steps_of_run(robot: str, log: StepLog) -> Steps:
    """The table of a run."""
    columns = (
        log.t_s,
        *log.positions_m.T,
        log.predicted_dbm,
        log.deviation_db,
        log.connectivity,
        log.true_dbm,
    )
    labels = (
        ["1" if connected else "0" for connected in log.connected],
        [rung.value for rung in log.rung],
        [verdict.value for verdict in log.verdict],
    )
    return _steps(robot, columns, labels)


def _steps(
    robot: str, columns: tuple[NDArray[np.float64], ...], labels: tuple[list[str], ...]
) -> Steps:
    return Steps(
        (robot,) * len(columns[0]),
        dict(zip(NUMBER_COLUMNS, columns, strict=True)),
        {name: tuple(cells) for name, cells in zip(LABEL_COLUMNS, labels, strict=True)},
    )


def steps_text(steps: Steps) -> str:
    """The file: numbers to the last digit, empty where there is none."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    columns = [finite_list(steps.numbers[name]) for name in NUMBER_COLUMNS]
    rows = zip(*columns, *(steps.labels[name] for name in LABEL_COLUMNS), strict=True)
    for step, row in enumerate(rows):
        cells = ("" if cell is None else cell for cell in row)
        writer.writerow([steps.robots[step], step, *cells])
    return text.getvalue()


def read_steps(path: Path) -> Steps:
    """Read what :func:`steps_text` wrote.

    Raises
    ------
    InputError
        It is missing, not text, lacks a column or has a cell that is no number; with row and
        column.
    """
    try:
        text = path.read_bytes().decode("utf-8")
        rows = list(csv.reader(io.StringIO(text), strict=True))
    except (OSError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"cannot be read: {reason}", file=path, remedy=REMEDY) from None
    if not rows or tuple(rows[0]) != COLUMNS:
        raise InputError(f"the header is not {','.join(COLUMNS)}", file=path, row=1, remedy=REMEDY)
    robots: list[str] = []
    numbers: dict[str, list[float]] = {name: [] for name in NUMBER_COLUMNS}
    labels: dict[str, list[str]] = {name: [] for name in LABEL_COLUMNS}
    for line, cells in enumerate(rows[1:], start=2):
        if len(cells) != len(COLUMNS):
            raise InputError(
                f"{len(cells)} cells where {len(COLUMNS)} should be",
                file=path,
                row=line,
                remedy=REMEDY,
            )
        row = dict(zip(COLUMNS, cells, strict=True))
        if row["step"] != str(line - 2):
            raise InputError(
                f"step {row['step']!r} where {line - 2} should be",
                file=path,
                key="step",
                row=line,
                remedy=REMEDY,
            )
        robots.append(row["robot"])
        for name in NUMBER_COLUMNS:
            numbers[name].append(_number(row[name], name, path, line))
        for name in LABEL_COLUMNS:
            labels[name].append(row[name])
    return Steps(
        tuple(robots),
        {name: np.array(column) for name, column in numbers.items()},
        {name: tuple(column) for name, column in labels.items()},
    )


def _number(cell: str, name: str, path: Path, line: int) -> float:
    """A finite number, or NaN for an empty cell of a column that may have some."""
    if not cell and name not in REQUIRED_NUMBERS:
        return np.nan
    try:
        number = float(cell)
    except ValueError:
        number = np.nan
    if not abs(number) <= LARGEST:
        raise InputError(
            f"{cell!r} is not a finite number", file=path, key=name, row=line, remedy=REMEDY
        )
    return number
