"""A run of several robots without its steps: what it is judged by, and how it went."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.run import Outcome, Run
from planopt.planning.team.team_run import ChannelLog, TargetLog, TeamRun, team_metrics
from planopt.problems.problem import Problem


@dataclass(frozen=True, eq=False)
class TeamSummary:
    """One closed loop of all robots, as comparisons list it.

    Attributes
    ----------
    horizon, planner, seed
        What was run.
    outcome, reason
        How it ended, and why in words.
    metrics
        What it is judged by, of all robots together, by name.
    rungs
        How often each rung released a step, over all robots.
    verified_rate
        Share of all released steps whose plan was verified.
    step_s
        ``(steps x robots,)`` wall time that planning one step of one robot took.
    connectivity, connected
        ``(steps x robots,)`` predicted probability of connection after each step, and whether
        there was one.
    cost_to_go
        None: there is no goal.
    """

    horizon: int
    planner: str
    seed: int
    outcome: Outcome
    reason: str
    metrics: dict[str, float]
    rungs: dict[str, int]
    verified_rate: float
    step_s: NDArray[np.float64]
    connectivity: NDArray[np.float64]
    connected: NDArray[np.bool_]
    cost_to_go: None = None


def team_summary(run: TeamRun) -> TeamSummary:
    """Summarise a run."""
    return summary_of(run.problem, run.seed, run.runs, run.target, run.channel)


def summary_of(
    problem: Problem,
    seed: int,
    runs: Sequence[Run],
    target: TargetLog | None,
    channel: ChannelLog,
) -> TeamSummary:
    """Summarise the parts of a run, as in :class:`planopt.planning.team.team_run.TeamRun`."""
    rungs: Counter[str] = Counter()
    for run in runs:
        rungs.update(run.rungs)
    return TeamSummary(
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        seed=seed,
        outcome=runs[0].outcome,
        reason=runs[0].reason,
        metrics=team_metrics(problem, runs, target, channel),
        rungs=dict(rungs),
        verified_rate=float(np.mean([run.verified_rate for run in runs])),
        step_s=np.concatenate([run.log.step_s[1:] for run in runs]),
        connectivity=np.concatenate([run.log.connectivity[1:] for run in runs]),
        connected=np.concatenate([run.log.connected[1:] for run in runs]),
    )
