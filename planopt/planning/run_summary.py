"""A run without its steps, as comparisons list it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.planning.results import Run


@dataclass(frozen=True, eq=False)
class RunSummary:
    """A run without its steps, as comparisons list it."""

    horizon: int
    planner: str
    cost_to_go: str | None  # None if there is no goal
    seed: int
    outcome: str
    reason: str  # Why it ended, in words
    # 0 if the task was done with every step verified, 3 if some was not, 4 if it was not done
    exit_code: int
    metrics: dict[str, float]  # Over all robots, by name
    rungs: dict[str, int]  # Number of steps released by each fallback, over all robots
    verified_rate: float  # Share of released steps whose plan was verified; NaN if none can be
    step_s: NDArray[np.float64]  # (steps x robots,) wall time of planning a step of one robot
    # (steps x robots,) predicted probability of connection after each step, and true connection;
    # empty for tasks without a channel
    connectivity: NDArray[np.float64]
    connected: NDArray[np.bool_]
    problem: str = ""  # Name of the problem
    # Keys of the problem that a study changed, with their values
    sweep: Mapping[str, Any] = field(default_factory=dict[str, Any])
    # (steps + 1,) each, by name: trace_p in m^2 and normalised_trace_p of the station's target
    # estimate; rms_db, rms_without_multipath_db and path_loss_variance_db2 of the channel
    traces: Mapping[str, NDArray[np.float64]] = field(
        default_factory=dict[str, NDArray[np.float64]]
    )


NOT_DONE = 4
"""Exit code of runs that did not complete their task."""

CHANNEL_TRACES = ("rms_db", "rms_without_multipath_db", "path_loss_variance_db2")


def _traces(run: Run) -> dict[str, NDArray[np.float64]]:
    """Return the errors of the target and channel estimates over the steps of a run, by name."""
    found = dict[str, NDArray[np.float64]]()
    if run.target is not None:
        found["trace_p"] = run.target.station_variance_m2
        found["normalised_trace_p"] = run.target.normalised_trace_p
    if run.channel is not None:
        found |= {name: getattr(run.channel, name) for name in CHANNEL_TRACES}
    return found


def short_summary(
    labels: tuple[int, str, str | None], seed: int, outcome: str, reason: str, exit_code: int
) -> RunSummary:
    """Return the summary of a run without steps; labels are horizon, planner and cost-to-go."""
    return RunSummary(
        *labels,
        seed=seed,
        outcome=str(outcome),
        reason=reason,
        exit_code=exit_code,
        metrics={},
        rungs={},
        verified_rate=np.nan,
        step_s=np.zeros(0),
        connectivity=np.zeros(0),
        connected=np.zeros(0, dtype=np.bool_),
    )


def summary_of(run: Run) -> RunSummary:
    """Summarise a run."""
    problem = run.problem
    return RunSummary(
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        cost_to_go=problem.cost_to_go,
        seed=run.seed,
        outcome=run.outcome.value,
        reason=run.reason,
        exit_code=run.exit_code,
        metrics=run.metrics,
        rungs=run.rungs,
        verified_rate=run.verified_rate,
        step_s=np.concatenate([one.log.step_s[1:] for one in run.runs]),
        connectivity=np.concatenate([one.log.connectivity[1:] for one in run.runs]),
        connected=np.concatenate([one.log.connected[1:] for one in run.runs]),
        problem=problem.name,
        traces=_traces(run),
    )
