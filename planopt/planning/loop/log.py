"""Logs of a closed loop: each robot's steps, the target, and how well the channel was known."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Rung, Verdict
from planopt.robots.drive import Drive
from planopt.short_repr import short_repr


class Outcome(StrEnum):
    """How a closed loop ended."""

    REACHED = "reached"
    STALLED = "stalled"
    STEP_LIMIT = "step_limit"
    NO_PLAN = "no_plan"
    COMPLETED = "completed"


@dataclass(frozen=True)
class StepLog:
    """Columns over the steps of one robot's run; row 0 is the start.

    All arrays have length ``steps + 1``. ``rung`` and ``verdict`` of a row belong to the plan
    that led there (row 0: ``plan``/``verified`` by convention).

    Attributes
    ----------
    t_s, positions_m
        Time and ``(x, y)``.
    predicted_dbm, deviation_db, connectivity
        Prediction for this place *before* it was measured, by the plan that led there.
    true_dbm, connected
        Truth at this place.
    step_s
        Wall time that planning this step took; row 0 is 0.
    polish_gain_s
        How much better than the lattice path the released one is, in the objective's unit (seconds
        for a cost); row 0 is 0.
    relaxation_db
        By how much the bound was relaxed at this step (0: not).
    """

    t_s: NDArray[np.float64]
    positions_m: NDArray[np.float64]
    predicted_dbm: NDArray[np.float64]
    deviation_db: NDArray[np.float64]
    connectivity: NDArray[np.float64]
    true_dbm: NDArray[np.float64]
    connected: NDArray[np.bool_]
    step_s: NDArray[np.float64]
    polish_gain_s: NDArray[np.float64]
    relaxation_db: NDArray[np.float64]
    rung: tuple[Rung, ...]
    verdict: tuple[Verdict, ...]

    __repr__ = short_repr


@dataclass(frozen=True)
class Metrics:
    """What a run is judged by.

    Attributes
    ----------
    goal_time_s
        Time to the goal; NaN if it was not reached.
    path_m
        Driven length.
    true_connected_share
        Share of steps connected in truth.
    longest_outage_m
        Longest driven length without a true connection.
    predicted_min_connectivity
        Least predicted P(connected) over the released steps.
    polish_gain
        Mean relative gain of the polish over the lattice start.
    measured_steps
        How many steps brought a measurement.

    What tells of steps is NaN where none was driven.
    """

    goal_time_s: float
    path_m: float
    true_connected_share: float
    longest_outage_m: float
    predicted_min_connectivity: float
    polish_gain: float
    measured_steps: int


@dataclass(frozen=True, eq=False)
class RobotRun:
    """One robot's part of a closed loop.

    Attributes
    ----------
    robot
        Its name.
    outcome, reason
        How the closed loop ended, and why in words.
    log, metrics
        See their types.
    drive
        States and inputs over the steps; None for the single integrator.
    """

    robot: str
    outcome: Outcome
    reason: str
    log: StepLog
    metrics: Metrics
    drive: Drive | None = None

    __repr__ = short_repr

    @property
    def verified_rate(self) -> float:
        """Share of released steps whose plan was verified (NaN if none was released)."""
        released = self.log.verdict[1:]
        verified = sum(v is Verdict.VERIFIED for v in released)
        return verified / len(released) if released else float("nan")

    @property
    def rungs(self) -> dict[str, int]:
        """How often each fallback released a step."""
        counts: dict[str, int] = {}
        for rung in self.log.rung[1:]:
            counts[rung.value] = counts.get(rung.value, 0) + 1
        return counts


@dataclass(frozen=True, eq=False)
class TargetLog:
    """A target over a run, row 0 at the start.

    Attributes
    ----------
    true_m, station_mean_m
        ``(steps + 1, 2)`` where it was, and where the station thought that it was.
    station_variance_m2
        ``(steps + 1,)`` trace of the station's covariance of its position.
    station_determinant_m4
        ``(steps + 1,)`` determinant of that covariance.
    nees
        ``(steps + 1,)`` e' P^-1 e of the station's estimate of its position, with the error e.
    nis
        ``(steps, robots)`` nu' S^-1 nu of each robot's filter, with the innovation nu of its
        measurement and the covariance S that the filter expects of it; NaN without measurement.
    delivered
        ``(steps, robots)`` whose packets arrived.
    """

    true_m: NDArray[np.float64]
    station_mean_m: NDArray[np.float64]
    station_variance_m2: NDArray[np.float64]
    station_determinant_m4: NDArray[np.float64]
    nees: NDArray[np.float64]
    nis: NDArray[np.float64]
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
    rms_without_multipath_db
        ``(steps + 1,)`` as `rms_db`, the error against path loss and shadowing alone.
    path_loss_variance_db2
        ``(steps + 1,)`` variance of the predicted path loss, gamma^T M gamma, its mean over the
        workspace.
    """

    rms_db: NDArray[np.float64]
    anmse_db: NDArray[np.float64]
    theta_variance_db: NDArray[np.float64]
    log_det_m: NDArray[np.float64]
    rms_without_multipath_db: NDArray[np.float64]
    path_loss_variance_db2: NDArray[np.float64]

    __repr__ = short_repr
