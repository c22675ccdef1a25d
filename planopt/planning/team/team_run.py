"""The log of a closed loop whose objective is a sum of terms, of one robot or several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.fields.truth import Truth
from planopt.planning.loop.rule_metrics import rule_metrics
from planopt.planning.loop.run import Run
from planopt.planning.plan import Plan
from planopt.planning.short_results import only, short_run
from planopt.planning.team.least_distances import (
    driven_motion,
    least_moving_clearances_m,
    least_separations_m,
)
from planopt.planning.worth.aim import Aim
from planopt.problems.problem import Problem
from planopt.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class TargetLog:
    """A target over a run, row 0 at the start.

    Attributes
    ----------
    true_m, station_mean_m
        ``(steps + 1, 2)`` where it was, and where the station thought that it was.
    station_variance_m2
        ``(steps + 1,)`` trace of the station's covariance of its position.
    delivered
        ``(steps, robots)`` whose packets arrived.
    """

    true_m: NDArray[np.float64]
    station_mean_m: NDArray[np.float64]
    station_variance_m2: NDArray[np.float64]
    delivered: NDArray[np.bool_]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class ChannelLog:
    """How well the channel was known after each step, row 0 at the start; of the first robot.

    Attributes
    ----------
    rms_db
        ``(steps + 1,)`` root mean square error of the predicted power over the workspace, the
        error against path loss, shadowing and multipath.
    anmse_db
        ``(steps + 1,)`` average normalised mean square error of [GM11], dB; fragile where the
        true power comes near 0 dBm, therefore beside `rms_db`.
    theta_variance_db
        ``(steps + 1,)`` trace of M over |theta|^2, in dB (Fig. 2 of [GM11]).
    log_det_m
        ``(steps + 1,)`` log det M, nats: what the criterion D lowers, whatever the units of theta.
    """

    rms_db: NDArray[np.float64]
    anmse_db: NDArray[np.float64]
    theta_variance_db: NDArray[np.float64]
    log_det_m: NDArray[np.float64]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class TeamRun:
    """One closed loop of all robots of a problem.

    Attributes
    ----------
    problem, seed
        As run (overrides applied).
    truth
        What was driven in, for pictures.
    runs, plans, aims, beliefs
        By robot: its log, its released plans, what each was made for, and what it believed at the
        end.
    first_measurements
        How many of a belief's measurements were there before the run.
    target
        None where nothing is tracked.
    channel
        How well it was known.
    further_truths
        As `truth`, of further stations.
    """

    problem: Problem
    seed: int
    truth: Truth
    runs: tuple[Run, ...]
    plans: tuple[tuple[Plan, ...], ...]
    aims: tuple[tuple[Aim, ...], ...]
    beliefs: tuple[Belief, ...]
    first_measurements: int
    target: TargetLog | None
    channel: ChannelLog
    further_truths: tuple[Truth, ...] = ()

    def __repr__(self) -> str:
        """Return what was run, how it ended, and its metrics."""
        return short_run(self.problem, self.seed, self.runs, self.metrics)

    @property
    def run(self) -> Run:
        """The log, where there is one robot; of several see `runs`.

        Raises
        ------
        InputError
            There are several.
        """
        return only(self.runs, "runs")

    @property
    def metrics(self) -> dict[str, float]:
        """What the run is judged by, of all robots together."""
        return team_metrics(self.problem, self.runs, self.target, self.channel)

    @property
    def verified_rate(self) -> float:
        """Share of all released steps whose plan was verified."""
        return float(np.mean([run.verified_rate for run in self.runs]))


def team_metrics(
    problem: Problem, runs: Sequence[Run], target: TargetLog | None, channel: ChannelLog
) -> dict[str, float]:
    """What a run is judged by, of all robots together, by name."""
    found: dict[str, float] = {}
    if target is not None:
        found["time_averaged_trace_p"] = float(target.station_variance_m2[1:].mean())
        found["final_trace_p"] = float(target.station_variance_m2[-1])
        found["delivered"] = float(target.delivered.mean())
    found["rms_db"] = float(channel.rms_db[-1])
    found["anmse_db"] = float(channel.anmse_db[-1])
    found["trace_m_db"] = float(channel.theta_variance_db[-1])
    found["log_det_m"] = float(channel.log_det_m[-1])
    each = [run.metrics for run in runs]
    found["measured_steps"] = float(sum(m.measured_steps for m in each))
    found["path_m"] = float(sum(m.path_m for m in each))
    found["true_connected_share"] = float(np.mean([m.true_connected_share for m in each]))
    found["longest_outage_m"] = float(max(m.longest_outage_m for m in each))
    found["predicted_min_connectivity"] = float(min(m.predicted_min_connectivity for m in each))
    found |= rule_metrics(problem, [run.log for run in runs])
    found["polish_gain"] = float(np.mean([m.polish_gain for m in each]))
    step_s = problem.planner.step_s
    motions = [driven_motion(run.log.positions_m, run.drive, step_s) for run in runs]
    if len(motions) > 1 and problem.constraints.separation_m > 0.0:
        found["min_separation_m"] = float(least_separations_m(motions).min())
    if problem.workspace.moving:
        clearances = least_moving_clearances_m(problem, motions)
        found["min_moving_clearance_m"] = float(clearances.min())
    return found
