"""A closed loop as the JSON object that ``planopt simulate --json`` prints and ``run.json`` holds.

The saved object also holds every released plan, robot by robot, so that each can be judged again on
what was believed when it was made.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.validation.calibration import ReliabilityBin
from planopt.planning.certificate import excused_steps
from planopt.planning.files.record import NotNegative, Record, finite, finite_list, plain
from planopt.planning.files.run_tables import drive_json
from planopt.planning.files.solution_json import (
    BlockedRecord,
    TrajectoryRecord,
    aim_json,
    blocked_json,
    holes_json,
    pivot_json,
)
from planopt.planning.loop.clairvoyant import COSTS
from planopt.planning.loop.log import Metrics, Outcome, RobotRun
from planopt.planning.loop.metrics import run_holes, run_reliability
from planopt.planning.plan import Plan
from planopt.planning.run_summary import RunSummary, summary_of
from planopt.planning.worth.situation import Aim
from planopt.problems.problem import Problem

if TYPE_CHECKING:
    from planopt.planning.run import Run


class ReleasedRecord(TrajectoryRecord):
    """A released plan of a run."""

    kkt_residual: NotNegative | None


class RobotPlansRecord(Record):
    """The released plans of one robot."""

    robot: str
    released: list[ReleasedRecord]


class RunRecord(Record):
    """The contents of ``run.json`` that a replay starts from."""

    seed: int = Field(ge=0)
    outcome: str
    message: str
    plans: list[RobotPlansRecord]
    blocked: list[BlockedRecord] = Field(default=[])
    problem_file: dict[str, Any]


def run_json(run: Run) -> dict[str, Any]:
    """Return the JSON keys of ``simulate``."""
    return {
        "problem": run.problem.name,
        **summary_json(summary_of(run)),
        "reliability": reliability_json(run_reliability(run.runs)),
        "robots": [
            _robot(run.problem, one, made) for one, made in zip(run.runs, run.plans, strict=True)
        ],
        **blocked_json(run.blocked),
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


def summary_json(summary: RunSummary) -> dict[str, Any]:
    """A run without its steps, as comparisons list it."""
    return {
        "horizon": summary.horizon,
        "planner": summary.planner,
        "cost_to_go": summary.cost_to_go,
        "seed": summary.seed,
        "outcome": summary.outcome,
        "message": summary.reason,
        "metrics": {name: finite(value) for name, value in summary.metrics.items()},
        "rungs": summary.rungs,
        "verified_rate": finite(summary.verified_rate),
        "step_s": step_times_json(summary.step_s),
    }


def released_plans_json(run: Run) -> list[dict[str, Any]]:
    """Return released plans by robot, in order, with what judging them again needs."""
    return [
        {
            "robot": one.robot,
            "released": [
                _released(run.problem, plan, aim) for plan, aim in zip(made, known, strict=True)
            ],
        }
        for one, made, known in zip(run.runs, run.plans, run.aims, strict=True)
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
        "robots": [],
    }


def step_times_json(seconds: NDArray[np.float64]) -> dict[str, float | None]:
    """Median, 95 % quantile and largest planning time of a step; null without steps."""
    if seconds.size == 0:
        return {"p50": None, "p95": None, "max": None}
    p50, p95, largest = np.quantile(seconds, [0.5, 0.95, 1.0])
    return {"p50": finite(p50), "p95": finite(p95), "max": finite(largest)}


def _robot(problem: Problem, run: RobotRun, plans: Sequence[Plan]) -> dict[str, Any]:
    """One robot's trajectory and metrics, the steps excused, and holes on the way to a goal."""
    log, metrics = run.log, run.metrics
    holes = {"holes": holes_json(run_holes(run))}
    return {
        "name": run.robot,
        "t_s": finite_list(log.t_s),
        "x_m": finite_list(log.positions_m[:, 0]),
        "y_m": finite_list(log.positions_m[:, 1]),
        "connectivity": finite_list(log.connectivity),
        **drive_json(run.drive),
        "path_m": finite(metrics.path_m),
        "true_connected_share": finite(metrics.true_connected_share),
        "longest_outage_m": finite(metrics.longest_outage_m),
        "measured_steps": metrics.measured_steps,
        "rungs": run.rungs,
        "verified_rate": finite(run.verified_rate),
        "excused": plain(excused_steps([plan.certificate for plan in plans])),
        **(holes if problem.task == "reach" else {}),
    }


def _released(problem: Problem, plan: Plan, aim: Aim) -> dict[str, Any]:
    """One released plan, with the steps that miss the bound.

    Those of a plan to a goal are excused by its cost and that of the cheapest path that the
    verifier found.
    """
    proof = plan.certificate
    to_goal = {
        "pivot": pivot_json(plan.pivot),
        "path_cost_m": finite(proof.path_cost_m),
        "best_cost_m": finite(proof.best_cost_m),
    }
    return {
        "x_m": finite_list(plan.positions_m[:, 0]),
        "y_m": finite_list(plan.positions_m[:, 1]),
        "objective": finite(plan.objective),
        "lattice_objective": finite(plan.lattice_objective),
        "termination": plan.termination.value,
        "verdict": plan.verdict.value,
        "rung": plan.rung.value,
        "kkt_residual": finite(proof.kkt_residual),
        **drive_json(plan.drive),
        "aim": aim_json(aim),
        "relaxed_steps": list(proof.relaxed_steps),
        "relaxation_db": finite_list(proof.relaxation_db),
        "best_margin_db": finite_list(proof.best_margin_db),
        **(to_goal if problem.task == "reach" else {}),
    }
