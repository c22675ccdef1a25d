"""Saved plans and runs: folders with ``plan.json`` or ``run.json``, tables and beliefs.

The files of a folder are replaced together (:mod:`planopt.files.writing`).
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from planopt.arrays import Floats
from planopt.bounds.bound import Potential, Tilts
from planopt.errors import InputError
from planopt.files.compare import DIGEST, digest
from planopt.files.reading import read_text
from planopt.files.tables import REMEDY, Data, read_table
from planopt.objectives.terms.term import Aim
from planopt.planning.certificate import BlockedPath, Crossing, Relaxation
from planopt.planning.files.belief_file import (
    BELIEF_FILE,
    BOUND_FILE,
    SavedBelief,
    belief_arrays_of,
    beliefs_of_run,
    bound_arrays,
    read_belief,
    read_certificates,
)
from planopt.planning.files.result_json import (
    NoPlanRecord,
    PlanRecord,
    ReleasedPlan,
    RobotPlan,
    RunRecord,
    released_plans_json,
    run_json,
    solution_json,
)
from planopt.planning.files.run_tables import (
    KNOWLEDGE_FILE,
    STEPS_FILE,
    TARGET_FILE,
    columns_of_run,
    drive_of,
    tables_of,
)
from planopt.planning.loop.results import Run, Solution
from planopt.planning.plan import Pivot, Plan, Verdict
from planopt.problems.load import problem_from_dict
from planopt.problems.problem import Problem
from planopt.problems.tasks import Contents
from planopt.robots.dynamics import Drive, braked_motion
from planopt.world.motion import TimedMotion

PLAN_FILE, RUN_FILE = "plan.json", "run.json"

PLAN_OR_RUN = (
    *(PLAN_FILE, RUN_FILE, STEPS_FILE, BELIEF_FILE, "belief_*.npz", TARGET_FILE),
    *(BOUND_FILE, KNOWLEDGE_FILE, "plan.png", "run.png", "run.gif", "series.png", "belief.png"),
    "report.html",
)
"""Files of a plan or run, including figures; a folder contains either a plan or a run."""
FORMAT = 3  # Version of ``plan.json`` and ``run.json``
HALF_PAIR = re.compile(r"\\u[dD][89a-fA-F]")
"""Pattern of JSON escapes of surrogates, which must occur in pairs."""


def belief_files(problem: Problem) -> tuple[str, ...]:
    """Return the file names of the robots' beliefs in a run."""
    if len(problem.robots) == 1:
        return (BELIEF_FILE,)
    return tuple(f"belief_{robot.name}.npz" for robot in problem.robots)


def contents(result: Solution | Run) -> Contents:
    """Return the file contents of a solution, or of a run with one belief per robot."""
    if isinstance(result, Run):
        data = {**run_json(result), "plans": released_plans_json(result)}
        arrays = zip(belief_files(result.problem), beliefs_of_run(result), strict=True)
        return Contents(RUN_FILE, signed(data), tables_of(result), dict(arrays))
    arrays, bounds = {BELIEF_FILE: belief_arrays_of(result.belief)}, bound_arrays(result.plans)
    arrays |= {BOUND_FILE: bounds} if bounds else {}
    return Contents(PLAN_FILE, signed(solution_json(result)), tables_of(result), arrays)


def signed(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON object of a plan or run with its format and digest."""
    data = {"format": FORMAT, **data}
    return {**data, DIGEST: digest(data)}


@dataclass(frozen=True, eq=False)
class SavedPlan:
    """Plan of one robot as read from a file."""

    record: RobotPlan | ReleasedPlan  # Data that only the planner knows
    path_m: Floats  # (N + 1, 2)
    drive: Drive | None
    motion: TimedMotion  # Motion along the path, and braking after it
    certificate: Potential | Tilts | None = None  # Certificate of its bound

    @property
    def pivot(self) -> Pivot | None:
        """Return the saved terminal waypoint; None without one."""
        return None if self.record.pivot is None else self.record.pivot.pivot

    def aim(self, watched: Aim) -> Aim:
        """Return the inputs `watched`, with steering path and other robots' plans from the file."""
        saved_aim, turns = self.record.aim, self.record.aim.steering_turns_m
        planned = tuple(np.array(path).reshape(-1, 2) for path in saved_aim.pending_m)
        return replace(
            watched,
            steering_turns_m=None if turns is None else np.array(turns),
            pending=replace(watched.pending, planned_m=planned),
        )


@dataclass(frozen=True, eq=False)
class Saved:
    """Saved plan or run, as read from its files but not verified."""

    file: Path  # The JSON file
    data: Mapping[str, Any]  # Content of the JSON file
    record: PlanRecord | RunRecord | NoPlanRecord  # Typed keys needed by a replay
    problem: Problem  # Problem in the JSON file
    tables: Mapping[str, Data] = field(default_factory=dict[str, Data])  # By file name
    beliefs: tuple[SavedBelief, ...] = ()  # One per robot of a run
    plans: tuple[tuple[SavedPlan, ...], ...] = ()  # By robot and step
    blocked: tuple[BlockedPath, ...] = ()

    def explanation(self, plans: Sequence[Plan]) -> tuple[Relaxation | Crossing, ...]:
        """Return the saved explanation, with the coverage holes of the verified `plans`."""
        if not isinstance(self.record, PlanRecord):
            return ()
        holes = {plan.robot: plan.holes for plan in plans if plan.verdict is Verdict.VERIFIED}
        crossings = [
            Crossing(
                one.robot,
                own,
                one.cost_m,
                self.problem.reach.outage_price,
                one.kept_m,
                one.outside_m,
                self.problem.constraints.p_min,
            )
            for one in self.record.crossings
            if (own := holes.get(one.robot))
        ]
        return (*self.record.explanation, *crossings)


def read_object(path: Path) -> tuple[Path, Mapping[str, Any]]:
    """Return the JSON file of a saved plan or run, and its content."""
    file = _json_file(path)
    return file, _read_json(file)


def saved_from(file: Path, data: Mapping[str, Any]) -> Saved:
    """Return the plan or run of a JSON file that is already loaded."""
    # Invalid content raises an InputError. Only a replay verifies the plans.
    if data.get("format") != FORMAT:
        message = f"is {data['format']!r}, should be {FORMAT}" if "format" in data else "is missing"
        raise _damaged(file, "format", message)
    has_plan, is_plan = data.get("robots") != [], file.name == PLAN_FILE
    kind = NoPlanRecord if not has_plan else PlanRecord if is_plan else RunRecord
    record = kind.read(data, file)
    tables = data.get("problem_file")
    if not isinstance(tables, dict):
        raise _damaged(file, "problem_file", "is missing or no table")
    problem = problem_from_dict(cast("dict[str, Any]", tables), file=file)
    if isinstance(record, NoPlanRecord):
        return Saved(file, data, record, problem)
    columns, names = columns_of_run(problem), belief_files(problem)
    if isinstance(record, PlanRecord):
        key = "robots"
        made = [[(f"robots[{number}]", one)] for number, one in enumerate(record.robots)]
        columns, names, blocked = {STEPS_FILE: columns[STEPS_FILE]}, (BELIEF_FILE,), ()
    else:
        key = "plans"
        made = [
            [(f"plans[{number}].released[{step}]", one) for step, one in enumerate(each.released)]
            for number, each in enumerate(record.plans)
        ]
        blocked = tuple(one.path for one in record.blocked)
        robots = [robot.name for robot in problem.robots]
        for number, one in enumerate(blocked):
            if one.robot not in robots:
                message = f"{one.robot!r} is not a robot of the run"
                raise _damaged(file, f"blocked[{number}].robot", message)
    if len(made) != len(problem.robots):
        message = f"{len(made)} robots, the problem has {len(problem.robots)}"
        raise _damaged(file, key, message)
    if len({len(each) for each in made}) > 1:
        raise _damaged(file, key, f"{[len(each) for each in made]} plans of the robots")
    certificates = (None,) * len(made)
    if isinstance(record, PlanRecord):
        certificates = read_certificates(file.parent / BOUND_FILE, len(made))
    plans = tuple(
        tuple(
            replace(_plan(file, where, problem, number, one), certificate=certificate)
            for where, one in each
        )
        for number, (each, certificate) in enumerate(zip(made, certificates, strict=True))
    )
    beliefs = tuple(read_belief(file.parent / name, len(problem.stations)) for name in names)
    read = {name: read_table(file.parent / name, each) for name, each in columns.items()}
    return Saved(file, data, record, problem, read, beliefs, plans, blocked)


def _plan(
    file: Path, key: str, problem: Problem, number: int, record: RobotPlan | ReleasedPlan
) -> SavedPlan:
    path_m, horizon = record.positions_m, problem.planner.horizon
    if len(path_m) != horizon + 1:
        message = f"has {len(path_m) - 1} steps, planner.horizon is {horizon}"
        raise _damaged(file, key, message)
    drive = drive_of(problem.robots[number], path_m, record.drive, file, f"{key}.drive")
    return SavedPlan(record, path_m, drive, braked_motion(path_m, drive, problem.planner.step_s))


def _json_file(path: Path) -> Path:
    """Return the JSON file of a folder, or the file itself."""
    if path.name in (PLAN_FILE, RUN_FILE):
        return path
    found = [path / name for name in (PLAN_FILE, RUN_FILE) if (path / name).is_file()]
    if not found:
        raise InputError(
            f"has no saved plan or run: {PLAN_FILE} and {RUN_FILE} are missing",
            file=path,
            remedy="give the folder named by --out",
        )
    if len(found) > 1:
        raise InputError(
            f"has both {PLAN_FILE} and {RUN_FILE}, but the other files belong to only one of them",
            file=path,
            remedy="remove one of the two",
        )
    return found[0]


def _read_json(file: Path) -> Mapping[str, Any]:
    """Return the JSON object in a file; duplicate keys raise an InputError."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise _damaged(file, twice, "stands there twice")
        return table

    text = read_text(file)
    try:
        data = json.loads(text, object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not JSON: {error}", file=file, remedy=REMEDY) from None
    if HALF_PAIR.search(text):
        try:
            json.dumps(data, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            message = "has a text with half of a surrogate pair"
            raise InputError(message, file=file, remedy=REMEDY) from None
    if not isinstance(data, dict):
        raise InputError("is not a JSON object", file=file, remedy=REMEDY)
    return cast("Mapping[str, Any]", data)


def _damaged(file: Path, key: str, message: str) -> InputError:
    """Return the error for a saved file that contradicts itself at `key`."""
    return InputError(message, file=file, key=key, remedy=REMEDY)
