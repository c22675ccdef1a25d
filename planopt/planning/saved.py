"""A plan or a run as a folder: ``plan.json`` or ``run.json``, ``steps.csv`` and ``belief.npz``.

The JSON file is withdrawn first and written last: where it stands, the other files belong to it.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from planopt.errors import InputError, OutputError
from planopt.files import write_text
from planopt.planning.belief_file import SavedBelief, read_belief, write_belief
from planopt.planning.run_json import RunRecord, released_plans_json, simulation_json
from planopt.planning.simulation import Simulation
from planopt.planning.solution import Solution
from planopt.planning.solution_json import (
    LARGEST,
    PlanRecord,
    finite_list,
    solution_json,
    strict_text,
)
from planopt.problems.messages import input_error
from planopt.problems.problem import Problem
from planopt.problems.save import problem_from_dict, problem_to_dict

PLAN_FILE, RUN_FILE = "plan.json", "run.json"
STEPS_FILE, BELIEF_FILE = "steps.csv", "belief.npz"

NUMBER_COLUMNS = ("t_s", "x_m", "y_m", "predicted_db", "deviation_db", "connectivity", "true_db")
COLUMNS = ("robot", "step", *NUMBER_COLUMNS, "connected", "rung", "verdict")
"""The columns of ``steps.csv`` (design, section 3)."""
REQUIRED_NUMBERS = ("t_s", "x_m", "y_m")

_REMEDY = "save the plan or run again"
_AnyRecord = TypeVar("_AnyRecord", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class Steps:
    """``steps.csv`` as it stands: the numbers by column, NaN where a cell is empty; (n,) each."""

    numbers: dict[str, NDArray[np.float64]]
    connected: tuple[str, ...]

    @property
    def positions_m(self) -> NDArray[np.float64]:
        """``(n, 2)``."""
        return np.stack([self.numbers["x_m"], self.numbers["y_m"]], axis=1)


@dataclass(frozen=True, eq=False)
class Saved:
    """A saved plan or run, read but not judged.

    Attributes
    ----------
    file
        Its JSON file.
    record
        What that says.
    problem
        Rebuilt from it.
    steps, belief
        From the files beside it; None where the record is of no plan at all.
    """

    file: Path
    record: PlanRecord | RunRecord
    problem: Problem
    steps: Steps | None
    belief: SavedBelief | None


def withdraw(folder: Path) -> None:
    """Remove the JSON file of an earlier result, before anything beside it is changed."""
    try:
        for name in (PLAN_FILE, RUN_FILE):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error


def save_solution(solution: Solution, folder: Path) -> None:
    """Save a plan so that it can be judged from its files alone.

    Raises
    ------
    OutputError
        The folder cannot be written; no JSON file is left in it.
    """
    withdraw(folder)
    plan = solution.plan
    numbers = (
        plan.t_s,
        *plan.positions_m.T,
        plan.mean_dbm,
        plan.deviation_db,
        plan.connectivity,
        np.full(len(plan.t_s), np.nan),
    )
    labels = ([""] * len(plan.t_s), [plan.rung] * len(plan.t_s), [plan.verdict] * len(plan.t_s))
    write_text(folder / STEPS_FILE, _csv_text(plan.robot, numbers, labels))
    write_belief(folder / BELIEF_FILE, solution.belief, np.zeros(0, dtype=np.int64))
    save_record(solution_json(solution), solution.problem, folder / PLAN_FILE)


def save_simulation(simulation: Simulation, folder: Path) -> None:
    """Save a run so that every released plan can be judged from its files alone.

    Raises
    ------
    OutputError
        The folder cannot be written; no JSON file is left in it.
    """
    withdraw(folder)
    log = simulation.run.log
    numbers = (
        log.t_s,
        *log.positions_m.T,
        log.predicted_dbm,
        log.deviation_db,
        log.connectivity,
        log.true_dbm,
    )
    labels = (["1" if connected else "0" for connected in log.connected], log.rung, log.verdict)
    write_text(folder / STEPS_FILE, _csv_text(simulation.run.robot, numbers, labels))
    write_belief(folder / BELIEF_FILE, simulation.belief, known_before_steps(simulation))
    data = {**simulation_json(simulation), "plans": released_plans_json(simulation)}
    save_record(data, simulation.problem, folder / RUN_FILE)


def save_record(data: dict[str, Any], problem: Problem, path: Path) -> None:
    """Write a JSON object with the problem in full beside its keys."""
    write_text(path, strict_text({**data, "problem_file": problem_to_dict(problem)}))


def known_before_steps(simulation: Simulation) -> NDArray[np.int64]:
    """How many measurements each step was planned on; ``(steps,)``.

    Measurements of the run are taken at the places driven to, in order, each place at most once
    a visit; so going along both finds the step of each.
    """
    taken = simulation.belief.posterior.measurements.positions_m
    count = simulation.first_measurements
    known: list[int] = []
    for place in simulation.run.log.positions_m[1:]:
        known.append(count)
        if count < len(taken) and np.array_equal(taken[count], place):
            count += 1
    return np.array(known, dtype=np.int64)


def read_saved(path: Path) -> Saved:
    """Read a saved plan or run.

    Parameters
    ----------
    path
        The folder, or the JSON file in it.

    Raises
    ------
    InputError
        A file is missing, truncated or not what it should be; with file, key or row.
    """
    file = _json_file(path)
    record = _read_record(file, PlanRecord if file.name == PLAN_FILE else RunRecord)
    problem = problem_from_dict(record.problem_file, file=file)
    for robot in record.robots:
        if not len(robot.t_s) == len(robot.x_m) == len(robot.y_m) == len(robot.connectivity):
            raise _damaged(file, "robots[0]", "t_s, x_m, y_m and connectivity differ in length")
    if not record.robots:
        return Saved(file, record, problem, None, None)
    steps = read_steps(file.parent / STEPS_FILE)
    rows, wanted = len(steps.positions_m), len(record.robots[0].t_s)
    if rows != wanted:
        raise InputError(
            f"has {rows} places where {file.name} has {wanted}",
            file=file.parent / STEPS_FILE,
            remedy=_REMEDY,
        )
    belief = read_belief(file.parent / BELIEF_FILE)
    if isinstance(record, RunRecord):
        _require_complete_run(file, record, belief)
    return Saved(file, record, problem, steps, belief)


def read_steps(path: Path) -> Steps:
    """Read ``steps.csv``.

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
        raise InputError(f"cannot be read: {reason}", file=path, remedy=_REMEDY) from None
    if not rows or tuple(rows[0]) != COLUMNS:
        raise InputError(f"the header is not {','.join(COLUMNS)}", file=path, row=1, remedy=_REMEDY)
    numbers: dict[str, list[float]] = {name: [] for name in NUMBER_COLUMNS}
    connected: list[str] = []
    for line, cells in enumerate(rows[1:], start=2):
        if len(cells) != len(COLUMNS):
            raise InputError(
                f"{len(cells)} cells where {len(COLUMNS)} should be",
                file=path,
                row=line,
                remedy=_REMEDY,
            )
        row = dict(zip(COLUMNS, cells, strict=True))
        if row["step"] != str(line - 2):
            raise InputError(
                f"step {row['step']!r} where {line - 2} should be",
                file=path,
                key="step",
                row=line,
                remedy=_REMEDY,
            )
        for name in NUMBER_COLUMNS:
            numbers[name].append(_number(row[name], name, path, line))
        connected.append(row["connected"])
    return Steps({name: np.array(column) for name, column in numbers.items()}, tuple(connected))


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
            f"{cell!r} is not a finite number", file=path, key=name, row=line, remedy=_REMEDY
        )
    return number


def _csv_text(
    robot: str, numbers: Iterable[NDArray[np.float64]], labels: Iterable[Iterable[str]]
) -> str:
    """The table: numbers to the last digit, empty where there is none."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    columns = [finite_list(column) for column in numbers]
    for step, row in enumerate(zip(*columns, *labels, strict=True)):
        writer.writerow([robot, step, *("" if cell is None else cell for cell in row)])
    return text.getvalue()


def _json_file(path: Path) -> Path:
    """The JSON file of a folder, or the one that was named."""
    if path.name in (PLAN_FILE, RUN_FILE):
        return path
    found = [path / name for name in (PLAN_FILE, RUN_FILE) if (path / name).is_file()]
    if not found:
        raise InputError(
            f"no saved plan or run: neither {PLAN_FILE} nor {RUN_FILE} is there",
            file=path,
            remedy="name the folder that --out was given",
        )
    return found[0]


def _read_record(file: Path, model: type[_AnyRecord]) -> _AnyRecord:
    try:
        return model.model_validate_json(file.read_bytes())
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=file) from None
    except ValidationError as error:
        if error.errors(include_url=False)[0]["type"] == "json_invalid":
            reason = error.errors(include_url=False)[0]["msg"]
            raise InputError(reason, file=file, remedy=_REMEDY) from None
        raise input_error(error, model, file=file) from None


def _require_complete_run(file: Path, record: RunRecord, belief: SavedBelief) -> None:
    """Every step has its plan and its belief."""
    steps = len(record.robots[0].t_s) - 1
    if len(record.plans) != steps:
        raise _damaged(file, "plans", f"{len(record.plans)} plans for {steps} steps")
    if len(belief.known_before_step) != steps:
        raise _damaged(
            belief.file,
            "known_before_step",
            f"{len(belief.known_before_step)} counts for {steps} steps",
        )
    for number, plan in enumerate(record.plans):
        if len(plan.x_m) != len(plan.y_m):
            raise _damaged(file, f"plans[{number}]", "x_m and y_m differ in length")


def _damaged(file: Path, key: str, message: str) -> InputError:
    return InputError(message, file=file, key=key, remedy=_REMEDY)
