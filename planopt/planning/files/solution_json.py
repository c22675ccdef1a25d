"""Solved problems as the JSON object that ``planopt solve --json`` prints and ``plan.json`` holds.

Keys of the whole are sums over the robots, the worst, or one text of all; each robot has its own
besides. Records type what is read back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import BeforeValidator, Field, TypeAdapter

from planopt.planning.certificate import Certificate
from planopt.planning.explain.explanation import Crossing, Relaxation
from planopt.planning.files.record import (
    NotNegative,
    Number,
    Place,
    Record,
    finite,
    finite_list,
    plain,
)
from planopt.planning.files.run_tables import drive_json
from planopt.planning.holes import BlockedWay, Hole
from planopt.planning.plan import Pivot, Plan, Termination, Verdict, share_gained
from planopt.planning.team.reservations import worst_of_robots
from planopt.planning.worth.situation import Aim
from planopt.problems.problem import Problem

if TYPE_CHECKING:
    from planopt.planning.solution import Solution

_AnyLabel = TypeVar("_AnyLabel", bound=Enum)


class PivotRecord(Record):
    """The way beyond the horizon."""

    x_m: Number
    y_m: Number
    cost_m: NotNegative
    metre_cost: float = Field(default=1.0, ge=1, le=1e7)


class AimRecord(Record):
    """External inputs of an objective: expected target and steering path, if any."""

    target_x_m: list[Number] | None
    target_y_m: list[Number] | None
    steering_m: Place | None
    # The path to there, its start and its end included
    steering_turns_m: Annotated[list[Place], Field(min_length=2)] | None = None
    # Places of each plan of another robot that was counted
    pending_m: list[list[Place]] = Field(default=[])


class TrajectoryRecord(Record):
    """A plan: its places, the robot's own first, and what only its planner knows."""

    x_m: list[Number] = Field(min_length=2)
    y_m: list[Number]
    termination: str
    rung: str
    lattice_objective: float
    aim: AimRecord
    drive: dict[str, list[Number | None]] | None = None
    pivot: PivotRecord | None = None


class RouteRecord(Record):
    """The rest of the way to a goal, as the search found it."""

    x_m: list[Number] = Field(default=[], max_length=10**6)
    y_m: list[Number] = Field(default=[], max_length=10**6)


class ResidualRecord(Record):
    """The part of a plan's certificate that only the solver knows."""

    kkt_residual: NotNegative | None


class RobotPlanRecord(TrajectoryRecord):
    """One robot's plan."""

    wall_s: NotNegative
    solve_s: NotNegative
    iterations: int = Field(ge=0, le=10**9)
    certificate: ResidualRecord
    route: RouteRecord | None = None


class CrossingRecord(Record):
    """The cost of a way that crosses coverage holes, and what keeping contact takes."""

    robot: str
    cost_m: NotNegative
    kept_m: NotNegative
    outside_m: NotNegative


class HoleRecord(Record):
    """A stretch of a way that misses the bound on connectivity, by its two ends."""

    x_m: Place
    y_m: Place
    length_m: NotNegative
    min_connectivity: float = Field(ge=0, le=1)
    to_end: bool


class BlockedRecord(Record):
    """The cheapest way of a robot to its goal, which a hard bound on connectivity forbids."""

    robot: str
    x_m: list[Number] = Field(min_length=1, max_length=10**6)
    y_m: list[Number] = Field(min_length=1, max_length=10**6)
    holes: list[HoleRecord]


_RELAXATIONS = TypeAdapter(tuple[Relaxation, ...])

Explanation = Annotated[tuple[Relaxation, ...], BeforeValidator(_RELAXATIONS.validate_python)]


class PlanRecord(Record):
    """The contents of ``plan.json`` that a replay starts from."""

    seed: int = Field(ge=0)
    explanation: Explanation
    crossings: list[CrossingRecord] = Field(default=[])
    robots: list[RobotPlanRecord] = Field(min_length=1)
    problem_file: dict[str, Any]


class NoPlanRecord(Record):
    """The contents of ``plan.json`` or ``run.json`` where there is no plan."""

    seed: int = Field(ge=0)
    message: str
    explanation: Explanation = ()
    robots: list[Any] = Field(max_length=0)
    problem_file: dict[str, Any]


def solution_json(solution: Solution) -> dict[str, Any]:
    """Return the JSON keys of ``solve``.

    ``bound`` and ``gap`` are null: no bound on the objective is proven.
    """
    problem, plans = solution.problem, solution.plans
    only = plans[0] if len(plans) == 1 else None
    lattice = sum(plan.lattice_objective for plan in plans)
    gain = sum(plan.gain for plan in plans)
    objective = sum(plan.objective for plan in plans)
    return {
        **_question(problem, solution.seed),
        "termination": _worst([plan.termination for plan in plans]).value,
        "verdict": solution.verdict.value,
        "sense": problem.sense,
        "objective": finite(objective),
        "bound": None,
        "gap": None,
        "wall_s": finite(sum(plan.wall_s for plan in plans)),
        "solve_s": finite(sum(plan.solve_s for plan in plans)),
        "iterations": sum(plan.iterations for plan in plans),
        "certificate": certificate_json(
            worst_of_robots({plan.robot: plan.certificate for plan in plans})
        ),
        "robots": [
            _robot(problem, plan, aim) for plan, aim in zip(plans, solution.aims, strict=True)
        ],
        "rung": _worst([plan.rung for plan in plans]).value,
        "lattice_objective": finite(lattice),
        "polish_gain": finite(share_gained(gain, lattice, objective)),
        "message": only.message
        if only is not None
        else "; ".join(f"{plan.robot}: {plan.message}" for plan in plans if plan.message),
        "explanation": explanation_json(solution.explanation),
        "crossings": crossings_json(solution.explanation),
    }


def no_plan_json(
    problem: Problem,
    seed: int,
    message: str,
    explanation: Iterable[Relaxation] = (),
    blocked: Iterable[BlockedWay] = (),
) -> dict[str, Any]:
    """The same keys where there provably is no plan; `message` says why, `blocked` where."""
    return {
        **_question(problem, seed),
        "termination": Termination.NO_PATH.value,
        "verdict": Verdict.NONE.value,
        "sense": problem.sense,
        **dict.fromkeys(("objective", "bound", "gap", "wall_s", "solve_s", "iterations")),
        "certificate": no_certificate_json((message,)),
        "robots": [],
        **dict.fromkeys(("rung", "lattice_objective", "polish_gain")),
        "message": message,
        "explanation": explanation_json(explanation),
        "crossings": [],
        **blocked_json(blocked),
    }


def blocked_json(ways: Iterable[BlockedWay]) -> dict[str, Any]:
    """Return the key ``blocked`` where there are ways that a hard bound forbids, else nothing.

    Each has its holes.
    """
    found = [
        {
            "robot": one.robot,
            "x_m": one.way_m[:, 0].tolist(),
            "y_m": one.way_m[:, 1].tolist(),
            "holes": holes_json(one.holes),
        }
        for one in ways
    ]
    return {"blocked": found} if found else {}


def holes_json(holes: Iterable[Hole]) -> list[dict[str, Any]]:
    """Stretches of a way to a goal that miss the bound on connectivity."""
    return [
        {
            "x_m": [hole.from_m[0], hole.to_m[0]],
            "y_m": [hole.from_m[1], hole.to_m[1]],
            "length_m": hole.length_m,
            "min_connectivity": hole.least_connectivity,
            "to_end": hole.to_end,
        }
        for hole in holes
    ]


def pivot_json(pivot: Pivot | None) -> dict[str, float] | None:
    """The way beyond the horizon, which the objective charges."""
    if pivot is None:
        return None
    x_m, y_m = pivot.position_m.tolist()
    return {"x_m": x_m, "y_m": y_m, "cost_m": pivot.cost_m, "metre_cost": pivot.metre_cost}


def certificate_json(certificate: Certificate) -> dict[str, Any]:
    """Return a certificate; the clearance is null where there is no obstacle.

    A rule of connectivity has its key only where it is another than p_min at each step.
    """
    found: dict[str, Any] = plain(certificate)
    if found["rule"] is None:
        del found["rule"]
    return found


def no_certificate_json(reasons: Iterable[str]) -> dict[str, Any]:
    """Return the keys of a certificate where there is no plan to certify; `reasons` say why."""
    names = [part.name for part in fields(Certificate) if part.name != "rule"]
    lists = dict[str, Any](relaxed_steps=[], relaxation_db=[], best_margin_db=[])
    return {**dict.fromkeys(names), **lists, "reasons": list(reasons)}


def _question(problem: Problem, seed: int) -> dict[str, Any]:
    """Return what was asked."""
    return {
        "problem": problem.name,
        "horizon": problem.planner.horizon,
        "planner": problem.planner.name,
        "cost_to_go": problem.cost_to_go,
        "seed": seed,
    }


def explanation_json(explanation: Iterable[object]) -> list[dict[str, Any]]:
    """Return every change that would help as a table."""
    return [plain(one) for one in explanation if isinstance(one, Relaxation)]


def crossings_json(explanation: Iterable[object]) -> list[dict[str, Any]]:
    """Return why each way to a goal crosses coverage holes; the robots' `holes` have where."""
    return [
        {
            "robot": one.robot,
            "outage_price": one.outage_price,
            "cost_m": one.cost_m,
            "kept_m": one.kept_m,
            "outside_m": one.outside_m,
            "at_goal": one.at_goal,
        }
        for one in explanation
        if isinstance(one, Crossing)
    ]


def aim_json(aim: Aim) -> dict[str, Any]:
    """The aim of one plan; null where there is none."""
    x, y = (None, None) if aim.target_m is None else aim.target_m.T
    turns = aim.steering_turns_m
    planned = [[finite_list(place) for place in path] for path in aim.pending.planned_m]
    return {
        "target_x_m": None if x is None else finite_list(x),
        "target_y_m": None if y is None else finite_list(y),
        "steering_m": None if turns is None else finite_list(turns[-1]),
        "steering_turns_m": None if turns is None else [finite_list(turn) for turn in turns],
        **({"pending_m": planned} if planned else {}),
    }


def _robot(problem: Problem, plan: Plan, aim: Aim) -> dict[str, Any]:
    """One robot's plan; the way on from it where there is a goal."""
    on_the_way = {
        "pivot": pivot_json(plan.pivot),
        "route": {"x_m": finite_list(plan.route_m[:, 0]), "y_m": finite_list(plan.route_m[:, 1])},
        "holes": holes_json(plan.holes),
    }
    return {
        "name": plan.robot,
        "t_s": finite_list(plan.t_s),
        "x_m": finite_list(plan.positions_m[:, 0]),
        "y_m": finite_list(plan.positions_m[:, 1]),
        "connectivity": finite_list(plan.connectivity),
        **drive_json(plan.drive),
        "termination": plan.termination.value,
        "verdict": plan.verdict.value,
        "objective": finite(plan.objective),
        "wall_s": finite(plan.wall_s),
        "solve_s": finite(plan.solve_s),
        "iterations": plan.iterations,
        "certificate": certificate_json(plan.certificate),
        "rung": plan.rung.value,
        "lattice_objective": finite(plan.lattice_objective),
        "polish_gain": finite(plan.polish_gain),
        "message": plan.message,
        "aim": aim_json(aim),
        **(on_the_way if problem.task == "reach" else {}),
    }


def _worst(labels: Sequence[_AnyLabel]) -> _AnyLabel:
    """The worst: every kind of label names its members from good to bad."""
    return max(labels, key=list(type(labels[0])).index)
