"""Read a saved plan or run; judging it is another matter.

An InputError says what cannot be read. What can be read and is not true is for
:func:`planopt.planning.check.check.check` to reject.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from planopt.errors import InputError
from planopt.files.regular import read_text
from planopt.files.tables import REMEDY, Data, read_table
from planopt.planning.explain.explanation import Crossing, Relaxation
from planopt.planning.files.belief_file import BELIEF_FILE, SavedBelief, read_belief
from planopt.planning.files.run_json import ReleasedRecord, RunRecord
from planopt.planning.files.run_tables import STEPS_FILE, columns_of_run, drive_of, step_columns
from planopt.planning.files.saved import FORMAT, PLAN_FILE, RUN_FILE, belief_files
from planopt.planning.files.solution_json import NoPlanRecord, PlanRecord, RobotPlanRecord
from planopt.planning.holes import BlockedWay, Hole
from planopt.planning.plan import Pivot, Plan, Verdict
from planopt.planning.worth.situation import Aim
from planopt.problems.messages import input_error
from planopt.problems.problem import Problem
from planopt.problems.save import problem_from_dict
from planopt.robots.drive import Drive, braked_motion
from planopt.world.timed_motion import TimedMotion

HALF_PAIR = re.compile(r"\\u[dD][89a-fA-F]")
"""Escapes of which JSON may have one without its other half."""

_AnyRecord = TypeVar("_AnyRecord", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class SavedPlan:
    """One robot's plan: its trajectory, and what its planner alone knows."""

    path_m: NDArray[np.float64]  # (N + 1, 2)
    drive: Drive | None
    motion: TimedMotion  # Along the path, and braking after it
    kkt_residual: float | None
    lattice_objective: float
    termination: str
    rung: str
    pivot: Pivot | None
    route_m: NDArray[np.float64] | None  # (r, 2) from the path on; None for a plan of a run
    steering_turns_m: NDArray[np.float64] | None
    pending_m: tuple[NDArray[np.float64], ...]  # (N, 2) each
    wall_s: float = 0.0
    solve_s: float = 0.0
    iterations: int = 0

    def aim(self, watched: Aim) -> Aim:
        """Return what is `watched`, and the saved steering and plans of other robots."""
        pending = replace(watched.pending, planned_m=self.pending_m)
        return replace(watched, steering_turns_m=self.steering_turns_m, pending=pending)


@dataclass(frozen=True, eq=False)
class Saved:
    """A saved plan or run, read but not judged."""

    file: Path  # The JSON file
    data: Mapping[str, Any]  # All that it says
    record: PlanRecord | RunRecord | NoPlanRecord  # The same, typed, as far as a replay needs it
    problem: Problem  # Rebuilt from it
    tables: Mapping[str, Data] = field(default_factory=dict[str, Data])  # By file name
    # What plans rest on, one for each robot of a run
    beliefs: tuple[SavedBelief, ...] = ()
    plans: tuple[tuple[SavedPlan, ...], ...] = ()  # By robot and step
    blocked: tuple[BlockedWay, ...] = ()

    def explanation(self, plans: Sequence[Plan]) -> tuple[Relaxation | Crossing, ...]:
        """Return the explanation of a plan; crossings have the holes of verified `plans`."""
        if not isinstance(self.record, PlanRecord):
            return ()
        holes = {plan.robot: plan.holes for plan in plans if plan.verdict is Verdict.VERIFIED}
        p_min = self.problem.constraints.p_min
        crossings = [
            Crossing(
                one.robot,
                holes[one.robot],
                one.cost_m,
                self.problem.reach.outage_price,
                one.kept_m,
                one.outside_m,
                p_min,
            )
            for one in self.record.crossings
            if holes.get(one.robot)
        ]
        return (*self.record.explanation, *crossings)


def read_saved(path: Path) -> Saved:
    """Read a saved plan or run."""
    return saved_from(*read_object(path))


def read_object(path: Path) -> tuple[Path, Mapping[str, Any]]:
    """Return the JSON file of a saved plan or run, and what it says."""
    file = _json_file(path)
    return file, _read_json(file)


def saved_from(file: Path, data: Mapping[str, Any]) -> Saved:
    """Return what :func:`read_saved` does, of a JSON file that has been read."""
    if data.get("format") != FORMAT:
        message = f"is {data['format']!r}, should be {FORMAT}" if "format" in data else "is missing"
        raise damaged(file, "format", message)
    if data.get("robots") == []:
        record = _record(file, data, NoPlanRecord)
        return Saved(file, data, record, problem_from_dict(record.problem_file, file=file))
    if file.name == PLAN_FILE:
        record = _record(file, data, PlanRecord)
        problem = problem_from_dict(record.problem_file, file=file)
        _require_robots(file, "robots", record.robots, problem)
        columns = {STEPS_FILE: step_columns(problem)}
        names: tuple[str, ...] = (BELIEF_FILE,)
        plans = tuple(
            (_plan(file, f"robots[{number}]", problem, number, one),)
            for number, one in enumerate(record.robots)
        )
        blocked = ()
    else:
        record = _record(file, data, RunRecord)
        problem = problem_from_dict(record.problem_file, file=file)
        _require_robots(file, "plans", record.plans, problem)
        columns, names = columns_of_run(problem), belief_files(problem)
        plans = tuple(
            tuple(
                _plan(file, f"plans[{number}].released[{step}]", problem, number, released)
                for step, released in enumerate(one.released)
            )
            for number, one in enumerate(record.plans)
        )
        if len({len(made) for made in plans}) > 1:
            raise damaged(file, "plans", f"{[len(made) for made in plans]} plans of the robots")
        blocked = _blocked(record, problem, file)
    beliefs = tuple(read_belief(file.parent / name, len(problem.stations)) for name in names)
    tables = {name: read_table(file.parent / name, each) for name, each in columns.items()}
    return Saved(file, data, record, problem, tables, beliefs, plans, blocked)


def _require_robots(file: Path, key: str, said: Sequence[object], problem: Problem) -> None:
    if len(said) != len(problem.robots):
        message = f"{len(said)} robots, the problem has {len(problem.robots)}"
        raise damaged(file, key, message)


def _plan(
    file: Path, key: str, problem: Problem, number: int, said: RobotPlanRecord | ReleasedRecord
) -> SavedPlan:
    """Return one robot's plan as saved."""
    path_m = _places(file, key, said.x_m, said.y_m)
    drive = drive_of(problem.robots[number].dynamics, path_m, said.drive, file, f"{key}.drive")
    pivot, turns, route_m = said.pivot, said.aim.steering_turns_m, None
    if isinstance(said, RobotPlanRecord) and said.route is not None:
        route_m = _places(file, f"{key}.route", said.route.x_m, said.route.y_m)
    found = SavedPlan(
        path_m=path_m,
        drive=drive,
        motion=braked_motion(path_m, drive, problem.planner.step_s),
        kkt_residual=said.certificate.kkt_residual
        if isinstance(said, RobotPlanRecord)
        else said.kkt_residual,
        lattice_objective=said.lattice_objective,
        termination=said.termination,
        rung=said.rung,
        pivot=None
        if pivot is None
        else Pivot(np.array([pivot.x_m, pivot.y_m]), pivot.cost_m, pivot.metre_cost),
        route_m=route_m,
        steering_turns_m=None if turns is None else np.array(turns),
        pending_m=tuple(np.array(path).reshape(-1, 2) for path in said.aim.pending_m),
    )
    if isinstance(said, ReleasedRecord):
        return found
    return replace(found, wall_s=said.wall_s, solve_s=said.solve_s, iterations=said.iterations)


def _places(
    file: Path, key: str, x_m: Sequence[float], y_m: Sequence[float]
) -> NDArray[np.float64]:
    if len(x_m) != len(y_m):
        raise damaged(file, key, "x_m and y_m differ in length")
    return np.stack([x_m, y_m], axis=1).reshape(-1, 2)


def _blocked(record: RunRecord, problem: Problem, file: Path) -> tuple[BlockedWay, ...]:
    """Return the ways of the key ``blocked``."""
    names = [robot.name for robot in problem.robots]
    for number, one in enumerate(record.blocked):
        if one.robot not in names:
            message = f"{one.robot!r} is no robot of it"
            raise damaged(file, f"blocked[{number}].robot", message)
    return tuple(
        BlockedWay(
            one.robot,
            _places(file, f"blocked[{number}]", one.x_m, one.y_m),
            tuple(
                Hole(
                    (hole.x_m[0], hole.y_m[0]),
                    (hole.x_m[1], hole.y_m[1]),
                    hole.length_m,
                    hole.min_connectivity,
                    hole.to_end,
                )
                for hole in one.holes
            ),
        )
        for number, one in enumerate(record.blocked)
    )


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


def damaged(file: Path, key: str, message: str) -> InputError:
    """Return the error that a saved file contradicts itself at `key`."""
    return InputError(message, file=file, key=key, remedy=REMEDY)
