"""What a run is judged by, from its log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.validation.calibration import ReliabilityBin, reliability
from planopt.planning.holes import Hole, holes_along
from planopt.planning.loop.run import Metrics, Outcome, Run, StepLog
from planopt.planning.plan import Plan

POSSIBLE = {
    "goal_time_s": (0.0, np.inf),
    "path_m": (0.0, np.inf),
    "true_connected_share": (0.0, 1.0),
    "longest_outage_m": (0.0, np.inf),
    "predicted_min_connectivity": (0.0, 1.0),
    "time_averaged_trace_p": (0.0, np.inf),
    "final_trace_p": (0.0, np.inf),
    "delivered": (0.0, 1.0),
    "rms_db": (0.0, np.inf),
    "measured_steps": (0.0, np.inf),
    "stated_times_connected": (0.0, 1.0),
    "least_connected_share": (0.0, 1.0),
    "longest_outage_s": (0.0, np.inf),
    "data_mbit": (0.0, np.inf),
    "realised_cost_m": (0.0, np.inf),
    "clairvoyant_cost_m": (0.0, np.inf),
    "cost_ratio": (0.0, np.inf),
}
"""Least and largest value that a metric can have; one that is not here can have `ANY`."""

ANY = (-np.inf, np.inf)


def metrics_of(
    log: StepLog, plans: Sequence[Plan], outcome: Outcome, learnt: Sequence[bool]
) -> Metrics:
    """Compute the metrics of a run; `learnt` says whether each step brought a measurement.

    Shares are over the steps driven, the start not counted; a run of no step counts as wholly
    connected. The polish gain is the mean over the steps.
    """
    lengths = np.linalg.norm(np.diff(log.positions_m, axis=0), axis=1)
    connected = log.connected[1:]
    gains = [plan.polish_gain for plan in plans]
    return Metrics(
        goal_time_s=float(log.t_s[-1]) if outcome is Outcome.REACHED else float("nan"),
        path_m=float(lengths.sum()),
        true_connected_share=float(connected.mean()) if connected.size else 1.0,
        longest_outage_m=longest_outage_m(lengths, connected),
        predicted_min_connectivity=float(np.min(log.connectivity[1:], initial=1.0)),
        polish_gain=float(np.mean(gains)) if gains else 0.0,
        measured_steps=sum(learnt),
    )


def run_reliability(runs: Sequence[Run]) -> tuple[ReliabilityBin, ...]:
    """Tabulate predicted against true connection over the steps of all robots of a closed loop.

    Its steps belong together, so that there is no interval.
    """
    predicted = np.concatenate([run.log.connectivity[1:] for run in runs])
    connected = np.concatenate([run.log.connected[1:] for run in runs])
    return reliability(predicted, connected, np.zeros(len(predicted), dtype=np.intp))


def run_holes(run: Run) -> tuple[Hole, ...]:
    """Stretches of a driven path whose steps missed the bound when they were planned."""
    log = run.log
    return holes_along(log.positions_m, log.connectivity, log.relaxation_db > 0.0)


def longest_outage_m(lengths_m: NDArray[np.float64], connected: NDArray[np.bool_]) -> float:
    """Longest driven length between connected places, counting the steps that end in none.

    Parameters
    ----------
    lengths_m
        ``(n,)`` length of each step.
    connected
        ``(n,)`` whether the place that it ends at is connected.
    """
    longest = current = 0.0
    for length, is_connected in zip(lengths_m, connected, strict=True):
        current = 0.0 if is_connected else current + float(length)
        longest = max(longest, current)
    return longest
