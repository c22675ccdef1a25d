"""Plans of several robots as the JSON object that ``planopt solve --json`` prints.

The keys are those of one robot's plan: sums, the worst, or one text of all; each robot has its own
besides.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any, TypeVar

from pydantic import Field

from planopt.planning.explain.explanation import Relaxation
from planopt.planning.files.aim_json import AimRecord, aim_json
from planopt.planning.files.explanation_json import RelaxationRecord, explanation_json
from planopt.planning.files.solution_json import (
    CertificateRecord,
    NotNegative,
    Record,
    RobotRecord,
    certificate_json,
    finite,
    plan_json,
)
from planopt.planning.plan import Plan
from planopt.planning.solution import Solution
from planopt.planning.team.team_certificate import worst_of_robots
from planopt.planning.worth.aim import Aim
from planopt.problems.problem import Problem

_AnyLabel = TypeVar("_AnyLabel", bound=Enum)

OWN_KEYS = (
    "termination",
    "verdict",
    "objective",
    "wall_s",
    "solve_s",
    "iterations",
    "certificate",
    "rung",
    "lattice_objective",
    "polish_gain",
    "message",
)
"""Keys that each robot has beside its way."""


class RobotPlanRecord(RobotRecord):
    """One robot's plan: its way, and what only its planner knows."""

    termination: str
    verdict: str
    rung: str
    wall_s: NotNegative
    solve_s: NotNegative
    iterations: int = Field(ge=0, le=10**9)
    lattice_objective: float
    certificate: CertificateRecord
    aim: AimRecord


class TeamPlanRecord(Record):
    """What judging ``plan.json`` of a sum of terms starts from."""

    seed: int = Field(ge=0)
    explanation: list[RelaxationRecord]
    robots: list[RobotPlanRecord] = Field(min_length=1)
    problem_file: dict[str, Any]


def team_solution_json(solution: Solution) -> dict[str, Any]:
    """The JSON keys of ``solve``, of all robots."""
    return team_plan_json(
        solution.problem, solution.seed, solution.plans, solution.aims, solution.explanation
    )


def team_plan_json(
    problem: Problem,
    seed: int,
    plans: Sequence[Plan],
    aims: Sequence[Aim],
    explanation: Sequence[Relaxation] = (),
) -> dict[str, Any]:
    """As :func:`team_solution_json`, of plans and what they were asked for."""
    each = [plan_json(problem, seed, plan) for plan in plans]
    certificate = worst_of_robots({plan.robot: plan.certificate for plan in plans})
    lattice = sum(plan.lattice_objective for plan in plans)
    gain = sum(plan.gain for plan in plans)
    robots = [
        {**one["robots"][0], **{key: one[key] for key in OWN_KEYS}, "aim": aim_json(aim)}
        for one, aim in zip(each, aims, strict=True)
    ]
    return {
        **each[0],
        "termination": _last_named([plan.termination for plan in plans]).value,
        "verdict": _last_named([plan.verdict for plan in plans]).value,
        "objective": finite(sum(plan.objective for plan in plans)),
        "wall_s": finite(sum(plan.wall_s for plan in plans)),
        "solve_s": finite(sum(plan.solve_s for plan in plans)),
        "iterations": sum(plan.iterations for plan in plans),
        "certificate": certificate_json(certificate),
        "robots": robots,
        "rung": _last_named([plan.rung for plan in plans]).value,
        "lattice_objective": finite(lattice),
        "polish_gain": finite(gain / abs(lattice) if lattice else 0.0),
        "message": "; ".join(f"{plan.robot}: {plan.message}" for plan in plans if plan.message),
        "explanation": explanation_json(explanation),
    }


def _last_named(labels: Sequence[_AnyLabel]) -> _AnyLabel:
    """The worst: every kind of label names its members from good to bad."""
    return max(labels, key=list(type(labels[0])).index)
