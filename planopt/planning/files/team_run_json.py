"""A closed loop of several robots as the JSON object that ``planopt simulate --json`` prints.

The saved object also holds every released plan with what it was made for, robot by robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydantic import Field

from planopt.planning.files.aim_json import AimRecord, aim_json
from planopt.planning.files.run_json import (
    PlannedRecord,
    StepTimesRecord,
    released_plan_json,
    reliability_json,
    robot_json,
    step_times_json,
)
from planopt.planning.files.solution_json import Record, RobotRecord, finite
from planopt.planning.loop.metrics import run_reliability
from planopt.planning.loop.run import Run
from planopt.planning.plan import Plan
from planopt.planning.team.team_run import TeamRun
from planopt.planning.team.team_summary import TeamSummary, team_summary
from planopt.planning.worth.aim import Aim
from planopt.problems.problem import Problem


class TeamReleasedRecord(PlannedRecord):
    """One released plan of one robot."""

    aim: AimRecord


class RobotPlansRecord(Record):
    """The released plans of one robot."""

    robot: str
    released: list[TeamReleasedRecord]


class TeamRunRecord(Record):
    """What judging ``run.json`` of a sum of terms starts from."""

    seed: int = Field(ge=0)
    outcome: str
    step_s: StepTimesRecord
    robots: list[RobotRecord] = Field(min_length=1)
    plans: list[RobotPlansRecord]
    problem_file: dict[str, Any]


def team_run_json(run: TeamRun) -> dict[str, Any]:
    """The JSON keys of ``simulate``, of all robots."""
    return team_record_json(run.problem, team_summary(run), run.runs)


def team_record_json(problem: Problem, summary: TeamSummary, runs: Sequence[Run]) -> dict[str, Any]:
    """As :func:`team_run_json`, of a run's parts."""
    return {
        "problem": problem.name,
        **team_summary_json(summary),
        "reliability": reliability_json(run_reliability(runs)),
        "robots": [{**robot_json(run), **_own(run)} for run in runs],
    }


def team_summary_json(summary: TeamSummary) -> dict[str, Any]:
    """A run without its steps, as comparisons list it."""
    return {
        "horizon": summary.horizon,
        "planner": summary.planner,
        "cost_to_go": summary.cost_to_go,
        "seed": summary.seed,
        "outcome": summary.outcome.value,
        "message": summary.reason,
        "metrics": {name: finite(value) for name, value in summary.metrics.items()},
        "rungs": summary.rungs,
        "verified_rate": finite(summary.verified_rate),
        "step_s": step_times_json(summary.step_s),
    }


def team_plans_json(
    plans: Sequence[Sequence[Plan]], aims: Sequence[Sequence[Aim]]
) -> list[dict[str, Any]]:
    """Released plans by robot, in order, with what judging them again needs."""
    return [
        {
            "robot": made[0].robot,
            "released": [
                {**released_plan_json(plan), "aim": aim_json(aim)}
                for plan, aim in zip(made, known, strict=True)
            ],
        }
        for made, known in zip(plans, aims, strict=True)
    ]


def _own(run: Run) -> dict[str, Any]:
    """What is one robot's own beside its way."""
    metrics = run.metrics
    return {
        "path_m": finite(metrics.path_m),
        "true_connected_share": finite(metrics.true_connected_share),
        "longest_outage_m": finite(metrics.longest_outage_m),
        "measured_steps": metrics.measured_steps,
        "rungs": run.rungs,
        "verified_rate": finite(run.verified_rate),
    }
