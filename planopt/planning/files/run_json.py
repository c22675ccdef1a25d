"""A closed loop as the JSON object that ``planopt simulate --json`` prints and ``run.json`` holds.

The saved object also holds every released plan, so that each can be judged again on what was
believed when it was made.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.validation.calibration import ReliabilityBin
from planopt.planning.files.drive_table import drive_json
from planopt.planning.files.solution_json import (
    NotNegative,
    Number,
    PivotRecord,
    Record,
    RobotRecord,
    finite,
    finite_list,
    holes_json,
    pivot_json,
)
from planopt.planning.loop.clairvoyant import COSTS
from planopt.planning.loop.metrics import run_holes, run_reliability
from planopt.planning.loop.run import Metrics, Outcome, Run
from planopt.planning.loop.simulation import Simulation
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem


class PlannedRecord(Record):
    """A plan of a run: its places, now included, and what only the planner knows."""

    x_m: list[Number] = Field(min_length=2)
    y_m: list[Number]
    termination: str
    verdict: str
    rung: str
    lattice_objective: float
    kkt_residual: NotNegative | None
    drive: dict[str, list[Number | None]] | None = None


class ReleasedRecord(PlannedRecord):
    """One released plan of a run to a goal."""

    pivot: PivotRecord | None


class StepTimesRecord(Record):
    """Planning times of the steps."""

    p50: NotNegative | None
    p95: NotNegative | None
    max: NotNegative | None


class RunRecord(Record):
    """What judging ``run.json`` starts from."""

    seed: int = Field(ge=0)
    outcome: str
    step_s: StepTimesRecord
    robots: list[RobotRecord] = Field(min_length=1, max_length=1)
    plans: list[ReleasedRecord]
    problem_file: dict[str, Any]


def simulation_json(simulation: Simulation) -> dict[str, Any]:
    """The JSON keys of ``simulate``."""
    return run_json(simulation.problem, simulation.run)


def run_json(problem: Problem, run: Run) -> dict[str, Any]:
    """As :func:`simulation_json`, of a run and its problem."""
    return {
        "problem": problem.name,
        **run_summary(run),
        "reliability": reliability_json(run_reliability([run])),
        "holes": holes_json(run_holes(run)),
        "robots": [robot_json(run)],
    }


def reliability_json(bins: Iterable[ReliabilityBin]) -> list[dict[str, Any]]:
    """Predicted against realised connection, a bin each; ends of an interval are null without."""
    return [
        {
            "low": one.low,
            "high": one.high,
            "count": one.count,
            "groups": one.groups,
            "predicted_connectivity": one.predicted,
            "connected_share": one.realised,
            "ci_low": one.interval and one.interval[0],
            "ci_high": one.interval and one.interval[1],
        }
        for one in bins
    ]


def run_summary(run: Run) -> dict[str, Any]:
    """A run without its steps, as comparisons list it."""
    return {
        "horizon": run.horizon,
        "planner": run.planner,
        "cost_to_go": run.cost_to_go,
        "seed": run.seed,
        "outcome": run.outcome.value,
        "message": run.reason,
        "metrics": {name: finite(value) for name, value in run.all_metrics.items()},
        "rungs": run.rungs,
        "verified_rate": finite(run.verified_rate),
        "step_s": step_times_json(run.log.step_s[1:]),
    }


def released_plans_json(plans: Iterable[Plan]) -> list[dict[str, Any]]:
    """Released plans in order, with what judging them again needs, and what they were excused.

    Steps of a plan to a goal that miss the bound are excused by what it costs and what the cheapest
    path costs that the verifier found.
    """
    return [
        {
            **released_plan_json(plan),
            "pivot": pivot_json(plan.pivot),
            "relaxed_steps": list(plan.certificate.relaxed_steps),
            "path_cost_m": finite(plan.certificate.path_cost_m),
            "best_cost_m": finite(plan.certificate.best_cost_m),
        }
        for plan in plans
    ]


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
        "metrics": dict.fromkeys([*(field.name for field in fields(Metrics)), *COSTS]),
        "rungs": {},
        "verified_rate": None,
        "step_s": step_times_json(np.zeros(0)),
        "reliability": [],
        "holes": [],
        "robots": [],
    }


def step_times_json(seconds: NDArray[np.float64]) -> dict[str, float | None]:
    """Median, 95 % quantile and largest planning time of a step; null without steps."""
    if seconds.size == 0:
        return {"p50": None, "p95": None, "max": None}
    p50, p95, largest = np.quantile(seconds, [0.5, 0.95, 1.0])
    return {"p50": finite(p50), "p95": finite(p95), "max": finite(largest)}


def robot_json(run: Run) -> dict[str, Any]:
    """A robot's way."""
    log = run.log
    return {
        "name": run.robot,
        "t_s": finite_list(log.t_s),
        "x_m": finite_list(log.positions_m[:, 0]),
        "y_m": finite_list(log.positions_m[:, 1]),
        "connectivity": finite_list(log.connectivity),
        **drive_json(run.drive),
    }


def released_plan_json(plan: Plan) -> dict[str, Any]:
    """A released plan, but for what its objective charges beyond the horizon."""
    return {
        "x_m": finite_list(plan.positions_m[:, 0]),
        "y_m": finite_list(plan.positions_m[:, 1]),
        "objective": finite(plan.objective),
        "lattice_objective": finite(plan.lattice_objective),
        "termination": plan.termination.value,
        "verdict": plan.verdict.value,
        "rung": plan.rung.value,
        "kkt_residual": finite(plan.certificate.kkt_residual),
        **drive_json(plan.drive),
    }
