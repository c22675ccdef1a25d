"""The tables of a saved plan or run: ``steps.csv``, ``target.csv`` and ``knowledge.csv``.

``steps.csv`` has a row for every place; ``target.csv`` and ``knowledge.csv`` hold the target and
the known channel over a run. Row 0 is the start. What was delivered belongs to the step that ends
there, so row 0 has none. Numbers are written to the last digit; an empty cell says that there is
none.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.regular import read_text
from planopt.planning.files.drive_table import drive_table
from planopt.planning.files.record import LARGEST, REMEDY, finite_list
from planopt.planning.loop.log import ChannelLog, StepLog, TargetLog
from planopt.planning.plan import Plan
from planopt.planning.run import Run
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive


def read_rows(path: Path, columns: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and cells of every row below a header that must be `columns`."""
    text = read_text(path)
    try:
        rows = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise InputError(f"cannot be read: {error}", file=path, remedy=REMEDY) from None
    if not rows or rows[0] != list(columns):
        raise InputError(f"the header is not {','.join(columns)}", file=path, row=1, remedy=REMEDY)
    for line, cells in enumerate(rows[1:], start=2):
        if len(cells) != len(columns):
            raise InputError(
                f"{len(cells)} cells where {len(columns)} should be",
                file=path,
                row=line,
                remedy=REMEDY,
            )
        yield line, dict(zip(columns, cells, strict=True))


def read_number(cell: str, name: str, path: Path, line: int, *, may_miss: bool) -> float:
    """A finite number, or NaN for an empty cell of a column that may have some."""
    if not cell and may_miss:
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


STEPS_FILE = "steps.csv"

NUMBER_COLUMNS = ("t_s", "x_m", "y_m", "predicted_db", "deviation_db", "connectivity", "true_db")
LABEL_COLUMNS = ("connected", "rung", "verdict")
COLUMNS = ("robot", "step", *NUMBER_COLUMNS, *LABEL_COLUMNS)
"""The columns."""
REQUIRED_NUMBERS = ("t_s", "x_m", "y_m")


@dataclass(frozen=True, eq=False)
class Steps:
    """The table by columns."""

    robots: tuple[str, ...]  # Whose rows they are, and the number of each robot's step, row by row
    steps: tuple[int, ...]
    # `NUMBER_COLUMNS` by name, NaN where a cell is empty; (n,) each
    numbers: dict[str, NDArray[np.float64]]
    labels: dict[str, tuple[str, ...]]  # `LABEL_COLUMNS` by name
    # Columns of states and inputs by name, of robots that cannot turn or stop at will; NaN where a
    # cell is empty
    motion: dict[str, NDArray[np.float64]] = field(default_factory=dict[str, NDArray[np.float64]])

    @property
    def columns(self) -> tuple[str, ...]:
        """The header."""
        return (*COLUMNS, *self.motion)

    def take(self, rows: slice) -> Steps:
        """The table of some of the rows."""
        return Steps(
            self.robots[rows],
            self.steps[rows],
            {name: column[rows] for name, column in self.numbers.items()},
            {name: column[rows] for name, column in self.labels.items()},
            {name: column[rows] for name, column in self.motion.items()},
        )

    @property
    def positions_m(self) -> NDArray[np.float64]:
        """``(n, 2)``."""
        return np.stack([self.numbers["x_m"], self.numbers["y_m"]], axis=1)


def joined_steps(tables: Sequence[Steps]) -> Steps:
    """One table of several robots', one below the other."""
    return Steps(
        tuple(robot for table in tables for robot in table.robots),
        tuple(step for table in tables for step in table.steps),
        {
            name: np.concatenate([table.numbers[name] for table in tables])
            for name in NUMBER_COLUMNS
        },
        {
            name: tuple(cell for table in tables for cell in table.labels[name])
            for name in LABEL_COLUMNS
        },
        {
            name: np.concatenate(
                [table.motion.get(name, np.full(len(table.steps), np.nan)) for table in tables]
            )
            for name in dict.fromkeys(name for table in tables for name in table.motion)
        },
    )


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
    return _steps(plan.robot, columns, labels, plan.drive)


def steps_of_run(robot: str, log: StepLog, drive: Drive | None = None) -> Steps:
    """The table of a run; `drive` has states and inputs, where there are some."""
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
    return _steps(robot, columns, labels, drive)


def _steps(
    robot: str,
    columns: tuple[NDArray[np.float64], ...],
    labels: tuple[list[str], ...],
    drive: Drive | None,
) -> Steps:
    return Steps(
        (robot,) * len(columns[0]),
        tuple(range(len(columns[0]))),
        dict(zip(NUMBER_COLUMNS, columns, strict=True)),
        {name: tuple(cells) for name, cells in zip(LABEL_COLUMNS, labels, strict=True)},
        drive_table(drive),
    )


def steps_text(steps: Steps) -> str:
    """The file: numbers to the last digit, empty where there is none."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(steps.columns)
    columns = [finite_list(steps.numbers[name]) for name in NUMBER_COLUMNS]
    motion = [finite_list(column) for column in steps.motion.values()]
    rows = zip(*columns, *(steps.labels[name] for name in LABEL_COLUMNS), *motion, strict=True)
    for robot, step, row in zip(steps.robots, steps.steps, rows, strict=True):
        cells = ("" if cell is None else cell for cell in row)
        writer.writerow([robot, step, *cells])
    return text.getvalue()


def require_pandas() -> Any:
    """Return the module pandas, or raise an InputError that says what to install."""
    try:
        return import_module("pandas")
    except ImportError:
        raise InputError("pandas is not installed", remedy="pip install pandas") from None


def steps_dataframe(steps: Steps) -> Any:
    """Return the table as a pandas DataFrame; `connected` is a nullable boolean."""
    pandas = require_pandas()
    connected = [{"1": True, "0": False}.get(cell) for cell in steps.labels["connected"]]
    columns = {
        "robot": steps.robots,
        "step": steps.steps,
        **steps.numbers,
        **steps.labels,
        "connected": pandas.array(connected, dtype="boolean"),
        **steps.motion,
    }
    return pandas.DataFrame({name: columns[name] for name in steps.columns})


def read_steps(path: Path, motion_columns: Sequence[str] = ()) -> Steps:
    """Read what :func:`steps_text` wrote."""
    robots: list[str] = []
    steps: list[int] = []
    numbers: dict[str, list[float]] = {name: [] for name in (*NUMBER_COLUMNS, *motion_columns)}
    labels: dict[str, list[str]] = {name: [] for name in LABEL_COLUMNS}
    for line, row in read_rows(path, (*COLUMNS, *motion_columns)):
        step = len(steps) and steps[-1] + 1
        # The next robot's rows begin anew.
        if robots and row["robot"] != robots[-1] and row["step"] == "0":
            step = 0
        if row["step"] != str(step):
            raise InputError(
                f"step {row['step']!r} where {step} should be",
                file=path,
                key="step",
                row=line,
                remedy=REMEDY,
            )
        steps.append(step)
        robots.append(row["robot"])
        for name in numbers:
            numbers[name].append(
                read_number(row[name], name, path, line, may_miss=name not in REQUIRED_NUMBERS)
            )
        for name in LABEL_COLUMNS:
            labels[name].append(row[name])
    return Steps(
        tuple(robots),
        tuple(steps),
        {name: np.array(numbers[name]) for name in NUMBER_COLUMNS},
        {name: tuple(column) for name, column in labels.items()},
        {name: np.array(numbers[name]) for name in motion_columns},
    )


TARGET_FILE, KNOWLEDGE_FILE = "target.csv", "knowledge.csv"

KNOWLEDGE_COLUMNS = (
    *("t_s", "rms_db", "anmse_db", "trace_m_db", "log_det_m"),
    *("rms_without_multipath_db", "path_loss_variance_db2"),
)
FORMER_KNOWLEDGE_COLUMNS = KNOWLEDGE_COLUMNS[:5]
"""Those of files of the former format."""

NumberTable = Mapping[str, NDArray[np.float64]]
"""Columns of equal length by name, NaN where there is no number."""


def table_text(table: NumberTable) -> str:
    """The file of a table."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    for row in zip(*(finite_list(column) for column in table.values()), strict=True):
        writer.writerow(["" if cell is None else cell for cell in row])
    return text.getvalue()


def read_table(path: Path, columns: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Read what :func:`table_text` wrote."""
    found: dict[str, list[float]] = {name: [] for name in columns}
    for line, row in read_rows(path, columns):
        for name in columns:
            found[name].append(read_number(row[name], name, path, line, may_miss=True))
    return {name: np.array(column, dtype=np.float64) for name, column in found.items()}


def target_columns(problem: Problem) -> tuple[str, ...]:
    """The columns of ``target.csv``."""
    return (
        "t_s",
        "true_x_m",
        "true_y_m",
        "estimated_x_m",
        "estimated_y_m",
        "trace_p_m2",
        *(f"delivered_{robot.name}" for robot in problem.robots),
    )


def target_table(problem: Problem, target: TargetLog) -> NumberTable:
    """The target over a run."""
    count = len(target.true_m)
    arrived = np.vstack([np.full((1, len(problem.robots)), np.nan), target.delivered])
    columns = (
        problem.planner.step_s * np.arange(count, dtype=np.float64),
        *target.true_m.T,
        *target.station_mean_m.T,
        target.station_variance_m2,
        *arrived.T,
    )
    return dict(zip(target_columns(problem), columns, strict=True))


def knowledge_table(problem: Problem, channel: ChannelLog) -> NumberTable:
    """Return how well the channel was known over a run."""
    columns = (
        problem.planner.step_s * np.arange(len(channel.rms_db), dtype=np.float64),
        channel.rms_db,
        channel.anmse_db,
        channel.theta_variance_db,
        channel.log_det_m,
        channel.rms_without_multipath_db,
        channel.path_loss_variance_db2,
    )
    return dict(zip(KNOWLEDGE_COLUMNS, columns, strict=True))


def run_tables(run: Run) -> dict[str, NumberTable]:
    """Return the tables that a run has, by the name of their file."""
    tables: dict[str, NumberTable] = {}
    if run.channel is not None:
        tables[KNOWLEDGE_FILE] = knowledge_table(run.problem, run.channel)
    if run.target is not None:
        tables[TARGET_FILE] = target_table(run.problem, run.target)
    return tables
