"""Read a saved plan or run; judging it is another matter.

What cannot be read is an error. What can be read and is not true is for
:func:`planopt.planning.check.check.check` to reject. The former format is brought into today's, for
one version: it had no key ``format``, and a form of its own for the one robot of a problem that
is to reach a goal, with plans of a run without the robot's name and the way on to the goal beside
the robot.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from planopt.errors import InputError
from planopt.files.regular import read_text
from planopt.planning.files.belief_file import (
    BELIEF_FILE,
    SavedBelief,
    read_belief,
    station_prefix,
)
from planopt.planning.files.drive_table import drive_columns
from planopt.planning.files.record import REMEDY
from planopt.planning.files.run_json import ReleasedRecord, RunRecord
from planopt.planning.files.saved import FORMAT, PLAN_FILE, RUN_FILE, belief_files
from planopt.planning.files.solution_json import NoPlanRecord, PlanRecord, RobotRecord
from planopt.planning.files.steps_file import (
    FORMER_KNOWLEDGE_COLUMNS,
    KNOWLEDGE_COLUMNS,
    KNOWLEDGE_FILE,
    STEPS_FILE,
    TARGET_FILE,
    Steps,
    read_steps,
    read_table,
    target_columns,
)
from planopt.problems.messages import input_error
from planopt.problems.problem import Problem
from planopt.problems.save import problem_from_dict

HALF_PAIR = re.compile(r"\\u[dD][89a-fA-F]")
"""Escapes of which JSON may have one without its other half."""

_AnyRecord = TypeVar("_AnyRecord", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class Saved:
    """A saved plan or run, read but not judged."""

    # Its JSON file, and what that says, in full; in today's form if the file has a former one
    file: Path
    data: Mapping[str, Any]
    record: PlanRecord | RunRecord | NoPlanRecord  # The same, typed, as far as judging needs it
    problem: Problem  # Rebuilt from it
    # The rows of each robot; none where the record is of no plan at all
    steps: tuple[Steps, ...] = ()
    # The one that plans rest on; of each robot after a run; none where there is no plan
    beliefs: tuple[SavedBelief, ...] = ()
    # By file name: further tables of a run
    tables: Mapping[str, dict[str, NDArray[np.float64]]] = field(
        default_factory=dict[str, dict[str, NDArray[np.float64]]]
    )
    former: bool = False  # Whether the file has the form of an earlier version


def read_saved(path: Path) -> Saved:
    """Read a saved plan or run."""
    return saved_from(*read_object(path))


def read_object(path: Path) -> tuple[Path, Mapping[str, Any]]:
    """The JSON file of a saved plan or run, and what it says."""
    file = _json_file(path)
    return file, _read_json(file)


def saved_from(file: Path, said: Mapping[str, Any]) -> Saved:
    """Return what :func:`read_saved` does, of a JSON file that has been read."""
    data, former = without_former_forms(file, said)
    if data.get("format") != FORMAT:
        message = f"is {data['format']!r}, should be {FORMAT}" if "format" in data else "is missing"
        raise damaged(file, "format", message)
    if data.get("robots") == []:
        record = _record(file, data, NoPlanRecord)
    else:
        record = _record(file, data, PlanRecord if file.name == PLAN_FILE else RunRecord)
    problem = problem_from_dict(record.problem_file, file=file)
    if isinstance(record, NoPlanRecord):
        return Saved(file, data, record, problem, former=former)
    if len(record.robots) != len(problem.robots):
        raise damaged(
            file, "robots", f"{len(record.robots)} robots, the problem has {len(problem.robots)}"
        )
    _require_even(file, record.robots)
    table = read_steps(file.parent / STEPS_FILE, drive_columns(problem))
    _require_rows(file, table, record.robots)
    ends = np.cumsum([0, *(len(robot.t_s) for robot in record.robots)]).tolist()
    steps = tuple(table.take(slice(begin, end)) for begin, end in pairwise(ends))
    is_run = isinstance(record, RunRecord)
    beliefs = tuple(
        read_belief(file.parent / name, len(problem.stations))
        for name in (belief_files(problem) if is_run else (BELIEF_FILE,))
    )
    if not is_run:
        return Saved(file, data, record, problem, steps, beliefs, former=former)
    _require_complete_run(file, problem, record, beliefs)
    tables = _read_tables(file, problem, len(steps[0].steps), former)
    return Saved(file, data, record, problem, steps, beliefs, tables, former)


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


def _record(file: Path, data: Mapping[str, Any], model: type[_AnyRecord]) -> _AnyRecord:
    """Return what `file` says, typed."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise input_error(error, model, file=file).remedied(REMEDY) from None


def _require_even(file: Path, robots: Sequence[RobotRecord]) -> None:
    """Every robot's columns are of one length."""
    for number, robot in enumerate(robots):
        if not len(robot.t_s) == len(robot.x_m) == len(robot.y_m) == len(robot.connectivity):
            raise damaged(
                file, f"robots[{number}]", "t_s, x_m, y_m and connectivity differ in length"
            )


def _require_rows(file: Path, steps: Steps, robots: Sequence[RobotRecord]) -> None:
    """The table has a row for every place."""
    rows, wanted = len(steps.positions_m), sum(len(robot.t_s) for robot in robots)
    if rows != wanted:
        raise InputError(
            f"has {rows} places where {file.name} has {wanted}",
            file=file.parent / STEPS_FILE,
            remedy=REMEDY,
        )


def _require_complete_run(
    file: Path, problem: Problem, record: RunRecord, beliefs: Sequence[SavedBelief]
) -> None:
    """Every robot was driven as long as the others, and each of its steps has plan and belief."""
    if len(record.plans) != len(record.robots):
        raise damaged(
            file, "plans", f"of {len(record.plans)} robots where there are {len(record.robots)}"
        )
    counts = [len(robot.t_s) for robot in record.robots]
    # A run to a goal may be at its end where it starts.
    least = 1 if problem.task == "reach" else 2
    if min(counts) < max(counts) or counts[0] < least:
        raise damaged(
            file, "robots", f"{counts} places, should be as many of each and at least {least}"
        )
    for number, (robot, belief) in enumerate(zip(record.plans, beliefs, strict=True)):
        _require_complete_robot(
            file, f"plans[{number}].released", counts[0] - 1, robot.released, belief
        )


def _require_complete_robot(
    file: Path, key: str, steps: int, plans: Sequence[ReleasedRecord], belief: SavedBelief
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


def _read_tables(
    file: Path, problem: Problem, rows: int, former: bool
) -> dict[str, dict[str, NDArray[np.float64]]]:
    columns: dict[str, tuple[str, ...]] = {}
    if problem.task != "reach":
        columns[KNOWLEDGE_FILE] = FORMER_KNOWLEDGE_COLUMNS if former else KNOWLEDGE_COLUMNS
    if problem.targets and any(term.sensor is not None for term in problem.terms):
        columns[TARGET_FILE] = target_columns(problem)
    tables = {name: read_table(file.parent / name, wanted) for name, wanted in columns.items()}
    for name, table in tables.items():
        found = len(table["t_s"])
        if found != rows:
            raise InputError(
                f"has {found} rows where {file.name} has {rows} places of each robot",
                file=file.parent / name,
                remedy=REMEDY,
            )
    if KNOWLEDGE_FILE in tables:
        absent = dict.fromkeys(KNOWLEDGE_COLUMNS, np.full(rows, np.nan))
        tables[KNOWLEDGE_FILE] = {**absent, **tables[KNOWLEDGE_FILE]}
    return tables


def damaged(file: Path, key: str, message: str) -> InputError:
    """The error that a saved file contradicts itself at `key`."""
    return InputError(message, file=file, key=key, remedy=REMEDY)


OWN_PLAN_KEYS = (
    *("termination", "verdict", "objective", "wall_s", "solve_s", "iterations", "certificate"),
    *("rung", "lattice_objective", "polish_gain", "message"),
)
"""Keys of a plan that its robot has as well."""

ON_THE_WAY = ("pivot", "route", "holes")
"""Keys of a plan to a goal that stood beside its robot."""

OWN_METRICS = ("path_m", "true_connected_share", "longest_outage_m", "measured_steps")
"""Metrics of a run that its robots have as well."""

FORMER_DEFAULTS = (
    ("planner", "coordination", "decoupled"),
    ("objective", "outage_charge", "below_p_min"),
)
"""Table, key and value of what was so before there was a key: robots of a team counted nothing of
the others', and places that keep p_min cost nothing on the way to a goal."""

NO_AIM = dict.fromkeys(("target_x_m", "target_y_m", "steering_m", "steering_turns_m"))

Table = dict[str, Any]


def without_former_forms(file: Path, data: Mapping[str, Any]) -> tuple[Mapping[str, Any], bool]:
    """Return what a file says in today's form, and whether it has the former one.

    What does not have the form that it should have is left as it is, for the reader to report.
    """
    data = _with_former_defaults(data)
    if "format" in data or not isinstance(data.get("robots"), list):
        return data, False
    table = {"format": FORMAT, **data}
    try:
        # These keys have no place in today's files; runs of teams had the form of today's.
        if "holes" not in data and (file.name == PLAN_FILE or _reaches(table)):
            return data, False
        return (_plan if file.name == PLAN_FILE else _run)(table), True
    except (KeyError, TypeError, IndexError, AttributeError):
        # The reader names what is missing or of another kind.
        return {"format": FORMAT, **data}, True


def _with_former_defaults(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Say what was meant before there were keys that say so."""
    given = data.get("problem_file")
    tables = cast("Table", given) if isinstance(given, dict) else {}
    task = tables.get("problem")
    reaches = isinstance(task, dict) and cast("Table", task).get("task") == "reach"
    channel = tables.get("channel")
    if isinstance(channel, dict) and cast("Table", channel).get("calibration") == "none":
        tables = {**tables, "channel": {**cast("Table", channel)}}
        del tables["channel"]["calibration"]
        data = {**data, "problem_file": tables}
    changed: Table = {}
    for table, key, former in FORMER_DEFAULTS:
        settings = tables.get(table)
        if isinstance(settings, dict) and key not in settings and (reaches or table != "objective"):
            changed[table] = {**cast("Table", settings), key: former}
    return {**data, "problem_file": {**tables, **changed}} if changed else data


def _reaches(data: Table) -> bool:
    return data["problem_file"]["problem"]["task"] == "reach"


def _plan(data: Table) -> Table:
    on_the_way = {key: data.pop(key) for key in ON_THE_WAY if key in data}
    robots = cast("list[Table]", data["robots"])
    if robots and _reaches(data):
        own = {key: data[key] for key in OWN_PLAN_KEYS}
        data["robots"] = [{**robots[0], **own, "aim": NO_AIM, **on_the_way}, *robots[1:]]
    elif len(robots) == 1:
        data["message"] = str(data["message"]).removeprefix(f"{robots[0]['name']}: ")
    return data


def _run(data: Table) -> Table:
    holes = data.pop("holes", [])
    robots = cast("list[Table]", data["robots"])
    if not robots or not _reaches(data):
        return data
    own = {key: data["metrics"][key] for key in OWN_METRICS}
    own |= {key: data[key] for key in ("rungs", "verified_rate")}
    data["robots"] = [{**robots[0], **own, "holes": holes}, *robots[1:]]
    released = [{**plan, "aim": NO_AIM} for plan in data["plans"]]
    data["plans"] = [{"robot": robots[0]["name"], "released": released}]
    return data
