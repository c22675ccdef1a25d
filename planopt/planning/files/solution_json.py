"""A solved problem as the JSON object that ``planopt solve --json`` prints and ``plan.json`` holds.

What is read back for judging is described beside what is written. Strict JSON has no NaN and no
infinity: a number that does not exist is null.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from planopt.planning.certificate import Certificate
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.files.drive_table import drive_json
from planopt.planning.files.explanation_json import RelaxationRecord, explanation_json
from planopt.planning.holes import Hole
from planopt.planning.plan import Pivot, Plan, Termination, Verdict
from planopt.planning.solution import Solution
from planopt.problems.problem import Problem

LARGEST = 1e9
"""Positions, times, powers and parameters beyond this in a saved file are a fault."""

REMEDY = "save the plan or run again"
"""What to do about a saved file that cannot be read."""

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0)]


class Record(BaseModel):
    """Part of a saved JSON object: what judging starts from. The rest is computed again."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)


class RobotRecord(Record):
    """One robot's way: places after each step, with the probability of connection."""

    name: str
    t_s: list[Number] = Field(min_length=1)
    x_m: list[Number]
    y_m: list[Number]
    connectivity: list[float | None]


class CertificateRecord(Record):
    """What only the solver knows of the plan's own certificate."""

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


class PlanRecord(Record):
    """What judging ``plan.json`` starts from."""

    seed: int = Field(ge=0)
    termination: str
    verdict: str
    rung: str
    wall_s: NotNegative
    solve_s: NotNegative
    iterations: int = Field(ge=0, le=10**9)
    lattice_objective: float
    pivot: PivotRecord | None
    route: RouteRecord = RouteRecord()
    certificate: CertificateRecord
    explanation: list[RelaxationRecord]
    robots: list[RobotRecord] = Field(min_length=1, max_length=1)
    problem_file: dict[str, Any]


class NoPlanRecord(Record):
    """What judging ``plan.json`` or ``run.json`` starts from where there is no plan."""

    seed: int = Field(ge=0)
    message: str
    explanation: list[RelaxationRecord] = []
    robots: list[RobotRecord] = Field(max_length=0)
    problem_file: dict[str, Any]


def finite(value: float | None) -> float | None:
    """`value`, or None where it is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def finite_list(values: Iterable[float]) -> list[float | None]:
    """Every number of `values` by :func:`finite`."""
    return [finite(value) for value in values]


def solution_json(solution: Solution) -> dict[str, Any]:
    """The JSON keys of ``solve``.

    ``bound`` and ``gap`` are null: no lower bound is proven.
    """
    return plan_json(solution.problem, solution.seed, solution.plan, solution.explanation)


def plan_json(
    problem: Problem, seed: int, plan: Plan, explanation: Iterable[Relaxation] = ()
) -> dict[str, Any]:
    """As :func:`solution_json`, of a plan and what it was asked for."""
    return {
        **_question(problem, seed),
        "termination": plan.termination.value,
        "verdict": plan.verdict.value,
        "sense": problem.sense,
        "objective": finite(plan.objective),
        "bound": None,
        "gap": None,
        "wall_s": finite(plan.wall_s),
        "solve_s": finite(plan.solve_s),
        "iterations": plan.iterations,
        "certificate": certificate_json(plan.certificate),
        "robots": [_robot(plan)],
        "rung": plan.rung.value,
        "lattice_objective": finite(plan.lattice_objective),
        "polish_gain": finite(plan.polish_gain),
        "pivot": pivot_json(plan.pivot),
        "route": {"x_m": finite_list(plan.route_m[:, 0]), "y_m": finite_list(plan.route_m[:, 1])},
        "holes": holes_json(plan.holes),
        "message": plan.message,
        "explanation": explanation_json(explanation),
    }


def no_plan_json(
    problem: Problem, seed: int, message: str, explanation: Iterable[Relaxation] = ()
) -> dict[str, Any]:
    """The same keys where there provably is no plan; `message` says why."""
    return {
        **_question(problem, seed),
        "termination": Termination.NO_PATH.value,
        "verdict": Verdict.NONE.value,
        "sense": problem.sense,
        **dict.fromkeys(("objective", "bound", "gap", "wall_s", "solve_s", "iterations")),
        "certificate": no_certificate_json((message,)),
        "robots": [],
        **dict.fromkeys(("rung", "lattice_objective", "polish_gain", "pivot", "route")),
        "holes": [],
        "message": message,
        "explanation": explanation_json(explanation),
    }


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
    """What was asked."""
    return {
        "problem": problem.name,
        "horizon": problem.planner.horizon,
        "planner": problem.planner.name,
        "cost_to_go": problem.cost_to_go,
        "seed": seed,
    }


def _robot(plan: Plan) -> dict[str, Any]:
    return {
        "name": plan.robot,
        "t_s": finite_list(plan.t_s),
        "x_m": finite_list(plan.positions_m[:, 0]),
        "y_m": finite_list(plan.positions_m[:, 1]),
        "connectivity": finite_list(plan.connectivity),
        **drive_json(plan.drive),
    }
