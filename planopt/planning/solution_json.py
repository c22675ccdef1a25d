"""A solved problem as the JSON object that ``planopt solve --json`` prints and ``plan.json`` holds.

What is read back for judging is described beside what is written. Strict JSON has no NaN and no
infinity: a number that does not exist is null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from planopt.planning.plan import Certificate, Plan, Termination, Verdict
from planopt.planning.solution import Solution
from planopt.problems.problem import Problem

LARGEST = 1e9
"""Positions, times, powers and parameters beyond this in a saved file are a fault."""

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Residual = Annotated[float, Field(ge=0)]


class Record(BaseModel):
    """Part of a saved JSON object; keys that are not judged are let through."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)


class RobotRecord(Record):
    """One robot's way: places after each step, with the probability of connection."""

    name: str
    t_s: list[Number] = Field(min_length=1)
    x_m: list[Number]
    y_m: list[Number]
    connectivity: list[float | None]


class CertificateRecord(Record):
    """What the plan's own certificate claims."""

    min_clearance_m: float | None
    min_connectivity: float | None
    kkt_residual: Residual | None


class PlanRecord(Record):
    """What is judged of ``plan.json``."""

    verdict: Verdict
    message: str
    certificate: CertificateRecord
    robots: list[RobotRecord] = Field(max_length=1)
    problem_file: dict[str, Any]


def strict_text(data: Mapping[str, Any]) -> str:
    """`data` as one line of strict JSON.

    Raises
    ------
    ValueError
        A number in it is not finite.
    """
    return json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n"


def finite(value: float | None) -> float | None:
    """`value`, or None where it is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def finite_list(values: Iterable[float]) -> list[float | None]:
    """Every number of `values` by :func:`finite`."""
    return [finite(value) for value in values]


def solution_json(solution: Solution) -> dict[str, Any]:
    """The JSON keys of ``solve`` (design, section 3).

    ``bound`` and ``gap`` are null: no lower bound is proven.
    """
    plan = solution.plan
    return {
        **_question(solution.problem, solution.seed),
        "termination": plan.termination.value,
        "verdict": plan.verdict.value,
        "sense": solution.problem.sense,
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
        "polish_gain": finite(_polish_gain(plan)),
        "message": plan.message,
    }


def no_plan_json(problem: Problem, seed: int, message: str) -> dict[str, Any]:
    """The same keys where there provably is no plan; `message` says why."""
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
    }


def certificate_json(certificate: Certificate) -> dict[str, Any]:
    """A certificate; the clearance is null where there is no obstacle."""
    return {
        "min_clearance_m": finite(certificate.min_clearance_m),
        "min_connectivity": finite(certificate.min_connectivity),
        "dynamics_defect": finite(certificate.dynamics_defect),
        "kkt_residual": finite(certificate.kkt_residual),
        "posterior": certificate.posterior,
        "relaxed_steps": list(certificate.relaxed_steps),
        "relaxation_db": finite_list(certificate.relaxation_db),
        "best_margin_db": finite_list(certificate.best_margin_db),
        "no_connected_way": certificate.no_connected_way,
        "reasons": list(certificate.reasons),
    }


def no_certificate_json(reasons: Iterable[str]) -> dict[str, Any]:
    """The keys of a certificate where there is no plan to certify; `reasons` say why."""
    return {
        **dict.fromkeys(
            ("min_clearance_m", "min_connectivity", "dynamics_defect", "kkt_residual", "posterior")
        ),
        "relaxed_steps": [],
        "relaxation_db": [],
        "best_margin_db": [],
        "no_connected_way": False,
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
    }


def _polish_gain(plan: Plan) -> float:
    """The part of the lattice path's cost that the polish saved."""
    if plan.lattice_objective == 0.0:
        return 0.0
    return (plan.lattice_objective - plan.objective) / plan.lattice_objective
