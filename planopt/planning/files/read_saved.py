"""Read a saved plan or run; judging it is another matter.

What cannot be read is an error. What can be read and is not true is for
:func:`planopt.planning.check.check.check` to reject.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import BaseModel, ValidationError

from planopt.errors import InputError
from planopt.files.regular import read_text
from planopt.files.result_folder import require_one_result
from planopt.planning.files.belief_file import (
    BELIEF_FILE,
    SavedBelief,
    read_belief,
    station_prefix,
)
from planopt.planning.files.drive_table import drive_columns
from planopt.planning.files.run_json import PlannedRecord, RunRecord
from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, RUN_FILE
from planopt.planning.files.solution_json import REMEDY, NoPlanRecord, PlanRecord, RobotRecord
from planopt.planning.files.steps_file import STEPS_FILE, Steps, read_steps
from planopt.problems.messages import input_error
from planopt.problems.problem import Problem
from planopt.problems.save import problem_from_dict

HALF_PAIR = re.compile(r"\\u[dD][89a-fA-F]")
"""Escapes of which JSON may have one without its other half."""

_AnyRecord = TypeVar("_AnyRecord", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class Saved:
    """A saved plan or run, read but not judged.

    Attributes
    ----------
    file
        Its JSON file.
    data
        What that says, in full.
    record
        The same, typed, as far as judging needs it.
    problem
        Rebuilt from it.
    steps, belief
        From the files beside it; None where the record is of no plan at all.
    """

    file: Path
    data: Mapping[str, Any]
    record: PlanRecord | RunRecord | NoPlanRecord
    problem: Problem
    steps: Steps | None
    belief: SavedBelief | None


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
    return saved_from(*read_object(path))


def read_object(path: Path) -> tuple[Path, Mapping[str, Any]]:
    """The JSON file of a saved plan or run, and what it says.

    Raises
    ------
    InputError
        There is none, it is no JSON object, or its folder holds files of two results.
    """
    file = _json_file(path)
    require_one_result(file.parent, PLAN_OR_RUN)
    return file, _read_json(file)


def saved_from(file: Path, data: Mapping[str, Any]) -> Saved:
    """As :func:`read_saved`, of a JSON file that has been read."""
    if data.get("robots") == []:
        record = record_of(file, data, NoPlanRecord)
    else:
        record = record_of(file, data, PlanRecord if file.name == PLAN_FILE else RunRecord)
    problem = problem_from_dict(record.problem_file, file=file)
    if isinstance(record, NoPlanRecord):
        return Saved(file, data, record, problem, None, None)
    require_even(file, record.robots)
    steps = read_steps(file.parent / STEPS_FILE, drive_columns(problem))
    require_rows(file, steps, record.robots)
    belief = read_belief(file.parent / BELIEF_FILE, len(problem.stations))
    if isinstance(record, RunRecord):
        steps_driven = len(record.robots[0].t_s) - 1
        require_complete_robot(file, "plans", steps_driven, record.plans, belief)
    return Saved(file, data, record, problem, steps, belief)


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
    if len(found) > 1:
        raise InputError(
            f"{PLAN_FILE} and {RUN_FILE} are both there, and the other files belong to one of them",
            file=path,
            remedy="remove one",
        )
    return found[0]


def _read_json(file: Path) -> Mapping[str, Any]:
    """The JSON object, in which every key stands once: readers differ in which of two they take."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise damaged(file, twice, "stands there twice")
        return table

    text = read_text(file)
    try:
        data = json.loads(text, object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise InputError(f"is no JSON: {error}", file=file, remedy=REMEDY) from None
    if HALF_PAIR.search(text):
        try:
            json.dumps(data, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise InputError(
                "has a text with half of a surrogate pair", file=file, remedy=REMEDY
            ) from None
    if not isinstance(data, dict):
        raise InputError("is no JSON object", file=file, remedy=REMEDY)
    return cast("Mapping[str, Any]", data)


def record_of(file: Path, data: Mapping[str, Any], model: type[_AnyRecord]) -> _AnyRecord:
    """What `file` says, typed.

    Raises
    ------
    InputError
        A key is missing or of the wrong kind.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise input_error(error, model, file=file) from None


def require_even(file: Path, robots: Sequence[RobotRecord]) -> None:
    """Every robot's columns are of one length."""
    for number, robot in enumerate(robots):
        if not len(robot.t_s) == len(robot.x_m) == len(robot.y_m) == len(robot.connectivity):
            raise damaged(
                file, f"robots[{number}]", "t_s, x_m, y_m and connectivity differ in length"
            )


def require_rows(file: Path, steps: Steps, robots: Sequence[RobotRecord]) -> None:
    """The table has a row for every place."""
    rows, wanted = len(steps.positions_m), sum(len(robot.t_s) for robot in robots)
    if rows != wanted:
        raise InputError(
            f"has {rows} places where {file.name} has {wanted}",
            file=file.parent / STEPS_FILE,
            remedy=REMEDY,
        )


def require_complete_robot(
    file: Path,
    key: str,
    steps: int,
    plans: Sequence[PlannedRecord],
    belief: SavedBelief,
) -> None:
    """Every step of a robot has its plan, at `key` of the file, and its belief."""
    if len(plans) != steps:
        raise damaged(file, key, f"{len(plans)} plans for {steps} steps")
    for station, own in enumerate(belief.stations):
        if len(own.known_before_step) != steps:
            raise damaged(
                belief.file,
                f"{station_prefix(station)}known_before_step",
                f"{len(own.known_before_step)} counts for {steps} steps",
            )
    for number, plan in enumerate(plans):
        if len(plan.x_m) != len(plan.y_m):
            raise damaged(file, f"{key}[{number}]", "x_m and y_m differ in length")


def damaged(file: Path, key: str, message: str) -> InputError:
    """The error that a saved file contradicts itself at `key`."""
    return InputError(message, file=file, key=key, remedy=REMEDY)
