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

    horizon: int  # What was run; `cost_to_go` is None if there is no goal
    planner: str
    cost_to_go: str | None
    seed: int
    outcome: str  # How it ended, and why in words
    reason: str
    # 0 if it did what the problem asks with every step verified, 3 if some was not, 4 if it did not
    exit_code: int
    metrics: dict[str, float]  # Of all robots together, by name
    rungs: dict[str, int]  # How often each fallback released a step, over all robots
    # Share of all released steps whose plan was verified; NaN where nothing is to be verified
    verified_rate: float
    # (steps x robots,) wall time that planning one step of one robot took
    step_s: NDArray[np.float64]
    # (steps x robots,) predicted probability of connection after each step, and whether there was
    # one; empty where no channel is learnt
    connectivity: NDArray[np.float64]
    connected: NDArray[np.bool_]
    problem: str = ""  # Name of the problem
    # Keys of the problem that a study changed, with their values
    sweep: Mapping[str, Any] = field(default_factory=dict[str, Any])
    # (steps + 1,) each, by name: trace_p, the trace in m^2 of the station's covariance of the
    # target's position, normalised_trace_p, the same over that of the first estimate, and of the
    # channel rms_db, rms_without_multipath_db and path_loss_variance_db2; empty on the way to a
    # goal
    traces: Mapping[str, NDArray[np.float64]] = field(
        default_factory=dict[str, NDArray[np.float64]]
    )


CHANNEL_TRACES = ("rms_db", "rms_without_multipath_db", "path_loss_variance_db2")


def _traces(run: Run) -> dict[str, NDArray[np.float64]]:
    """Return what was known over the steps of a run, by name."""
    found = dict[str, NDArray[np.float64]]()
    if run.target is not None:
        found["trace_p"] = run.target.station_variance_m2
        found["normalised_trace_p"] = run.target.normalised_trace_p
    if run.channel is not None:
        found |= {name: getattr(run.channel, name) for name in CHANNEL_TRACES}
    return found


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
