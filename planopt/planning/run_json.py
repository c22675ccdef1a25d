"""A closed loop as the JSON object that ``planopt simulate --json`` prints and ``run.json`` holds.

The saved object also holds every released plan, so that each can be judged again on what was
believed when it was made.
"""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.planning.plan import Plan, Verdict
from planopt.planning.run import Metrics, Outcome, Run
from planopt.planning.simulation import Simulation
from planopt.planning.solution_json import (
    Number,
    Record,
    Residual,
    RobotRecord,
    finite,
    finite_list,
)
from planopt.problems.problem import Problem


class ReleasedRecord(Record):
    """One released plan of a run: its places, now included."""

    x_m: list[Number] = Field(min_length=2)
    y_m: list[Number]
    verdict: Verdict
    kkt_residual: Residual | None


class RunRecord(Record):
    """What is judged of ``run.json``."""

    outcome: Outcome
    message: str
    robots: list[RobotRecord] = Field(max_length=1)
    plans: list[ReleasedRecord]
    problem_file: dict[str, Any]


def simulation_json(simulation: Simulation) -> dict[str, Any]:
    """The JSON keys of ``simulate`` (design, section 3)."""
    run = simulation.run
    return {"problem": simulation.problem.name, **run_summary(run), "robots": [_robot(run)]}


def run_summary(run: Run) -> dict[str, Any]:
    """A run without its steps, as comparisons list it."""
    return {
        "horizon": run.horizon,
        "planner": run.planner,
        "cost_to_go": run.cost_to_go,
        "seed": run.seed,
        "outcome": run.outcome.value,
        "message": run.reason,
        "metrics": {name: finite(value) for name, value in asdict(run.metrics).items()},
        "rungs": run.rungs,
        "verified_rate": finite(run.verified_rate),
        "step_s": _step_times(run.log.step_s[1:]),
    }


def released_plans_json(simulation: Simulation) -> list[dict[str, Any]]:
    """Every released plan in order, with what judging it again needs."""
    return [_plan(plan) for plan in simulation.plans]


def no_run_json(problem: Problem, seed: int, message: str) -> dict[str, Any]:
    """The same keys where there provably is no plan; `message` says why."""
    return {
        "problem": problem.name,
        "horizon": problem.planner.horizon,
        "planner": problem.planner.name,
        "cost_to_go": problem.cost_to_go,
        "seed": seed,
        "outcome": Outcome.NO_PLAN.value,
        "message": message,
        "metrics": {field.name: None for field in fields(Metrics)},
        "rungs": {},
        "verified_rate": None,
        "step_s": _step_times(np.zeros(0)),
        "robots": [],
    }


def _step_times(seconds: NDArray[np.float64]) -> dict[str, float | None]:
    """Median, 95 % quantile and largest planning time of a step; null without steps."""
    if seconds.size == 0:
        return {"p50": None, "p95": None, "max": None}
    p50, p95, largest = np.quantile(seconds, [0.5, 0.95, 1.0])
    return {"p50": finite(p50), "p95": finite(p95), "max": finite(largest)}


def _robot(run: Run) -> dict[str, Any]:
    log = run.log
    return {
        "name": run.robot,
        "t_s": finite_list(log.t_s),
        "x_m": finite_list(log.positions_m[:, 0]),
        "y_m": finite_list(log.positions_m[:, 1]),
        "connectivity": finite_list(log.connectivity),
    }


def _plan(plan: Plan) -> dict[str, Any]:
    return {
        "x_m": finite_list(plan.positions_m[:, 0]),
        "y_m": finite_list(plan.positions_m[:, 1]),
        "objective": finite(plan.objective),
        "termination": plan.termination.value,
        "verdict": plan.verdict.value,
        "rung": plan.rung.value,
        "kkt_residual": finite(plan.certificate.kkt_residual),
    }
