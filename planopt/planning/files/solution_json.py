"""Solved problems as the JSON object that ``planopt solve --json`` prints and ``plan.json`` holds.

Keys of the whole are sums over the robots, the worst, or one text of all; each robot has its own
besides. What is read back for judging is described beside what is written.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from planopt.errors import InputError
from planopt.planning.certificate import Certificate, Excused
from planopt.planning.explain.explanation import Crossing, Relaxation
from planopt.planning.files.drive_table import drive_json
from planopt.planning.files.record import (
    REMEDY,
    NotNegative,
    Number,
    Record,
    finite,
    finite_list,
)
from planopt.planning.holes import BlockedWay, Hole
from planopt.planning.plan import Pivot, Plan, Termination, Verdict, share_gained
from planopt.planning.solution import Solution
from planopt.planning.team.reservations import worst_of_robots
from planopt.planning.worth.situation import Aim
from planopt.problems.problem import Problem

_AnyLabel = TypeVar("_AnyLabel", bound=Enum)

Place = Annotated[list[Number], Field(min_length=2, max_length=2)]


class RobotRecord(Record):
    """One robot's trajectory: places after each step, with the probability of connection."""

    name: str
    t_s: list[Number] = Field(min_length=1)
    x_m: list[Number]
    y_m: list[Number]
    connectivity: list[float | None]


class CertificateRecord(Record):
    """The part of a plan's certificate that only the solver knows."""

    kkt_residual: NotNegative | None


class PivotRecord(Record):
    """The way beyond the horizon."""

    x_m: Number
    y_m: Number
    cost_m: NotNegative
    metre_cost: float = Field(default=1.0, ge=1, le=1e7)


class RouteRecord(Record):
    """The rest of the way to a goal, as the search found it."""

    x_m: list[Number] = Field(default=[], max_length=10**6)
    y_m: list[Number] = Field(default=[], max_length=10**6)


class AimRecord(Record):
    """External inputs of an objective: expected target and steering path, if any.

    `steering_turns_m` is the way there, its start and its end included. `pending_m` has the places
    of each plan of another robot that was counted.
    """

    target_x_m: list[Number] | None
    target_y_m: list[Number] | None
    steering_m: Place | None
    steering_turns_m: Annotated[list[Place], Field(min_length=2)] | None = None
    pending_m: list[list[Place]] = Field(default=[])


class RelaxationRecord(BaseModel):
    """One change by which there would be a verified plan."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True, extra="forbid")

    constraint: str
    unit: str
    value: float | None
    stages: list[int]
    shortfall: float | None = Field(ge=0)
    shortfall_unit: str
    relaxed_value: float | None
    verified: bool
    robot: str


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


class RobotPlanRecord(RobotRecord):
    """One robot's plan: its trajectory, and what only its planner knows."""

    termination: str
    verdict: str
    rung: str
    wall_s: NotNegative
    solve_s: NotNegative
    iterations: int = Field(ge=0, le=10**9)
    lattice_objective: float
    certificate: CertificateRecord
    aim: AimRecord
    pivot: PivotRecord | None = None
    route: RouteRecord = RouteRecord()


class PlanRecord(Record):
    """The contents of ``plan.json`` that judging starts from."""

    seed: int = Field(ge=0)
    explanation: list[RelaxationRecord]
    crossings: list[CrossingRecord] = Field(default_factory=list[CrossingRecord])
    robots: list[RobotPlanRecord] = Field(min_length=1)
    problem_file: dict[str, Any]


class NoPlanRecord(Record):
    """The contents of ``plan.json`` or ``run.json`` where there is no plan."""

    seed: int = Field(ge=0)
    message: str
    explanation: list[RelaxationRecord] = Field(default_factory=list[RelaxationRecord])
    robots: list[RobotRecord] = Field(max_length=0)
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


def blocked_again(
    said: Iterable[BlockedRecord], names: Collection[str], file: Path
) -> tuple[BlockedWay, ...]:
    """Return the ways of the key ``blocked``, of which nothing is judged."""
    for number, one in enumerate(said):
        if one.robot not in names:
            raise InputError(
                f"{one.robot!r} is no robot of it",
                file=file,
                key=f"blocked[{number}].robot",
                remedy=REMEDY,
            )
        if len(one.x_m) != len(one.y_m):
            raise InputError(
                f"has {len(one.x_m)} x_m and {len(one.y_m)} y_m",
                file=file,
                key=f"blocked[{number}]",
                remedy=REMEDY,
            )
    return tuple(
        BlockedWay(
            one.robot,
            np.stack([one.x_m, one.y_m], axis=1),
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
        for one in said
    )


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


def excused_json(steps: Iterable[Excused]) -> list[dict[str, Any]]:
    """Steps that miss the bound, and what excuses each."""
    return [asdict(one) for one in steps]


def pivot_json(pivot: Pivot | None) -> dict[str, float] | None:
    """The way beyond the horizon, which the objective charges."""
    if pivot is None:
        return None
    x_m, y_m = pivot.position_m.tolist()
    return {"x_m": x_m, "y_m": y_m, "cost_m": pivot.cost_m, "metre_cost": pivot.metre_cost}


def certificate_json(certificate: Certificate) -> dict[str, Any]:
    """A certificate; the clearance is null where there is no obstacle.

    A rule of connectivity has its key only where it is another than p_min at each step.
    """
    rule = certificate.rule
    return {
        "min_clearance_m": finite(certificate.min_clearance_m),
        "min_separation_m": finite(certificate.min_separation_m),
        "min_moving_clearance_m": finite(certificate.min_moving_clearance_m),
        "min_connectivity": finite(certificate.min_connectivity),
        "dynamics_defect": finite(certificate.dynamics_defect),
        "kkt_residual": finite(certificate.kkt_residual),
        "posterior": certificate.posterior,
        "relaxed_steps": list(certificate.relaxed_steps),
        "relaxation_db": finite_list(certificate.relaxation_db),
        "best_margin_db": finite_list(certificate.best_margin_db),
        "path_cost_m": finite(certificate.path_cost_m),
        "best_cost_m": finite(certificate.best_cost_m),
        "step_cost_m": finite(certificate.step_cost_m),
        "step_excess_m": finite(certificate.step_excess_m),
        "reasons": list(certificate.reasons),
        **({} if rule is None else {"rule": asdict(rule)}),
    }


def no_certificate_json(reasons: Iterable[str]) -> dict[str, Any]:
    """The keys of a certificate where there is no plan to certify; `reasons` say why."""
    return {
        **dict.fromkeys(
            (
                "min_clearance_m",
                "min_separation_m",
                "min_moving_clearance_m",
                "min_connectivity",
                "dynamics_defect",
                "kkt_residual",
                "posterior",
            )
        ),
        "relaxed_steps": [],
        "relaxation_db": [],
        "best_margin_db": [],
        **dict.fromkeys(("path_cost_m", "best_cost_m", "step_cost_m", "step_excess_m")),
        "reasons": list(reasons),
    }


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
    """Every change that would help as a table."""
    return [
        {
            "robot": one.robot,
            "constraint": one.constraint,
            "unit": one.unit,
            "value": one.value,
            "stages": list(one.stages),
            "shortfall": one.shortfall,
            "shortfall_unit": one.shortfall_unit,
            "relaxed_value": one.relaxed_value,
            "verified": one.verified,
        }
        for one in explanation
        if isinstance(one, Relaxation)
    ]


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


def explanation_again(records: Iterable[RelaxationRecord]) -> tuple[Relaxation, ...]:
    """Return what :func:`explanation_json` wrote."""
    return tuple(
        Relaxation(
            one.constraint,
            one.unit,
            one.value,
            tuple(one.stages),
            one.shortfall,
            one.shortfall_unit,
            one.relaxed_value,
            one.verified,
            one.robot,
        )
        for one in records
    )


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


def aim_again(record: AimRecord, watched: Aim) -> Aim:
    """The aim as it must be: what is `watched` as found again, the rest as it stands."""
    turns = record.steering_turns_m
    planned = tuple(np.array(path, dtype=np.float64).reshape(-1, 2) for path in record.pending_m)
    return replace(
        watched,
        steering_turns_m=None if turns is None else np.array(turns),
        pending=replace(watched.pending, planned_m=planned),
    )


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
