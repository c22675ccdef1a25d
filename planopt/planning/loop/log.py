"""Logs of a closed loop: the steps of each robot, the target, and the channel estimation errors."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.ground_truth import Truth, mean_power_dbm, true_power_dbm
from planopt.channel.parameters import regressors
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.plan import Rung, Verdict
from planopt.planning.proof.rule import search_power
from planopt.planning.stepping import TargetWatch
from planopt.robots.dynamics import Drive
from planopt.short_repr import short_repr
from planopt.targets.information_filter import noise_covariance_m2, predict


class Outcome(StrEnum):
    """Outcome of a closed loop."""

    REACHED = "reached"
    STALLED = "stalled"
    STEP_LIMIT = "step_limit"
    NO_PLAN = "no_plan"
    COMPLETED = "completed"


@dataclass(frozen=True)
class StepLog:
    """Log of one robot's run, with a row per step; row 0 is the start.

    All arrays have length ``steps + 1``. ``rung`` and ``verdict`` of a row belong to the plan that
    led there (row 0: ``plan``/``verified`` by convention).

    Attributes
    ----------
    t_s, positions_m
        Time, and position ``(x, y)``.
    predicted_dbm, deviation_db, connectivity
        Power and P(connected) predicted by the plan that led here, before the measurement.
    true_dbm, connected
        True power and connection at this position.
    step_s
        Wall time spent planning this step; row 0 is 0.
    polish_gain_s
        Objective gain of the released path over the lattice path; row 0 is 0.
    relaxation_db
        Shortfall of this step from p_min in dB; 0 if p_min is met.
    """

    t_s: Floats
    positions_m: Floats
    predicted_dbm: Floats
    deviation_db: Floats
    connectivity: Floats
    true_dbm: Floats
    connected: Mask
    step_s: Floats
    polish_gain_s: Floats
    relaxation_db: Floats
    rung: tuple[Rung, ...]
    verdict: tuple[Verdict, ...]

    __repr__ = short_repr

    @property
    def disconnected(self) -> Mask:
        """Return a mask ``(steps + 1,)`` of the steps known to be out of contact."""
        return ~self.connected & ~np.isnan(self.true_dbm)


@dataclass(frozen=True)
class Metrics:
    """Metrics of one robot's run.

    Attributes
    ----------
    goal_time_s
        Time to the goal; NaN if it was not reached.
    path_m
        Path length.
    true_connected_share
        Share of truly connected steps among the steps with known true power.
    longest_outage_m
        Longest path segment without a true connection.
    predicted_min_connectivity
        Minimum predicted P(connected) over the released steps.
    polish_gain
        Mean relative gain of refined plans over their lattice paths.
    measured_steps
        Number of steps with a measurement.

    Metrics over steps are NaN if the run has none.
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
    """Results of one robot in a closed-loop run.

    Attributes
    ----------
    robot
        Name of the robot.
    outcome, reason
        Outcome of the closed loop, and its reason as text.
    log, metrics
        Steps of the run, and metrics over them.
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
        """Return the share of released steps with a verified plan; NaN without steps."""
        released = self.log.verdict[1:]
        verified = sum(v is Verdict.VERIFIED for v in released)
        return verified / len(released) if released else float("nan")

    @property
    def rungs(self) -> dict[str, int]:
        """Return the number of steps released by each fallback."""
        return dict(Counter(rung.value for rung in self.log.rung[1:]))


@dataclass(frozen=True, eq=False)
class TargetLog:
    """Log of the target's track and its estimates over a run; row 0 is the start."""

    # (steps + 1, 2) true position, and the station's estimate
    true_m: Floats
    station_mean_m: Floats
    # (steps + 1,) trace of the covariance of the station's position estimate
    station_variance_m2: Floats
    station_determinant_m4: Floats  # (steps + 1,) determinant of this covariance
    nees: Floats  # (steps + 1,) e' P^-1 e with the error e of the station's position estimate
    # (steps, robots) nu' S^-1 nu of each robot's innovation nu; NaN without measurement
    nis: Floats
    delivered: Mask  # (steps, robots) whether the packet arrived

    __repr__ = short_repr

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.true_m)

    @property
    def normalised_trace_p(self) -> Floats:
        """Return the trace of the target covariance relative to its first value; (steps + 1,)."""
        return self.station_variance_m2 / self.station_variance_m2[0]


@dataclass(frozen=True, eq=False)
class ChannelLog:
    """Errors of the first robot's channel estimate after each step; row 0 is the start."""

    rms_db: Floats  # (steps + 1,) root mean square error of the predicted power over the workspace
    # (steps + 1,) average normalised mean square error of [GM11] in dB; unreliable near 0 dBm
    anmse_db: Floats
    # (steps + 1,) tr(M) / |theta|^2 in dB (Fig. 2 of [GM11]); NaN for known path loss
    theta_variance_db: Floats
    # (steps + 1,) log det M in nats (criterion D); NaN if a path loss parameter is known
    log_det_m: Floats
    # (steps + 1,) as `rms_db`, against path loss and shadowing without multipath
    rms_without_multipath_db: Floats
    # (steps + 1,) mean over the workspace of the path loss variance gamma^T M gamma
    path_loss_variance_db2: Floats

    __repr__ = short_repr

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.rms_db)


def channel_row(
    posteriors: Sequence[ChannelPosterior],
    truths: Sequence[Truth],
    places_m: Floats,  # (n, 2) positions of the predictions
) -> tuple[float, ...]:
    """Return the values of one row of :class:`ChannelLog`, computed over all stations."""
    power = np.stack([true_power_dbm(truth, places_m) for truth in truths])
    shadowed = np.stack([mean_power_dbm(truth, places_m) for truth in truths])
    predicted = np.stack([search_power(each, places_m).mean_db for each in posteriors])
    # Measured ground truth is unknown between readings.
    known = np.isfinite(power)
    error = (predicted - power)[known]
    # [GM11], section III-A2. The ratio is singular at 0 dBm, which never occurs in practice.
    ratio = error / np.where(power == 0.0, np.finfo(float).tiny, power)[known]
    covariances = [each.theta_covariance for each in posteriors]
    spread = sum(float(np.trace(covariance)) for covariance in covariances)
    size = sum(float(each.theta @ each.theta) for each in posteriors)
    log_det = sum(float(np.linalg.slogdet(covariance)[1]) for covariance in covariances)
    rows = [regressors(places_m, each.parameters.station) for each in posteriors]
    path_loss = [
        np.einsum("ni,ij,nj->n", row, covariance, row)
        for row, covariance in zip(rows, covariances, strict=True)
    ]
    # A known path loss has neither variance nor determinant in dB.
    return (
        float(np.sqrt((error**2).mean())),
        float(10.0 * np.log10((ratio**2).mean())),
        float(10.0 * np.log10(spread / size)) if spread > 0.0 else float("nan"),
        log_det if np.isfinite(log_det) else float("nan"),
        float(np.sqrt(((predicted - shadowed)[known] ** 2).mean())),
        float(np.mean(path_loss)),
    )


def target_log(watches: Iterable[TargetWatch | None], delivered: Mask) -> TargetLog | None:
    """Return the log of a target at the start and after each step; None without a target."""
    # Shapes: delivered (steps, robots).
    known = [watch for watch in watches if watch is not None]
    if not known:
        return None
    return TargetLog(
        true_m=known[0].true_m[: len(known)],
        station_mean_m=np.array([watch.station_mean_m for watch in known]),
        station_variance_m2=np.array([watch.station_variance_m2 for watch in known]),
        station_determinant_m4=np.array(
            [np.linalg.det(watch.station.covariance[:2, :2]) for watch in known]
        ),
        nees=np.array(
            [
                _squared(watch.station_mean_m - true_m, watch.station.covariance[:2, :2])
                for watch, true_m in zip(known, known[0].true_m, strict=False)
            ]
        ),
        nis=np.array([_innovations(*pair) for pair in pairwise(known)]).reshape(delivered.shape),
        delivered=delivered,
    )


def _innovations(before: TargetWatch, after: TargetWatch) -> list[float]:
    """Return the normalised innovation squared (NIS) of each robot's filter for one step."""
    sent, found = after.sent[-1], list[float]()
    for state, measured, place, seen in zip(
        before.robots, sent.measured_m, sent.positions_m, sent.seen, strict=True
    ):
        ahead = predict(before.model, state)
        mean = ahead.mean[:2]
        noise = noise_covariance_m2(before.sensor, place[None], mean)[0]
        expected = ahead.covariance[:2, :2] + noise
        found.append(_squared(measured - mean, expected) if seen else float("nan"))
    return found


def _squared(error: Floats, covariance: Floats) -> float:
    """Return the squared Mahalanobis distance of `error` for its `covariance`."""
    return float(error @ np.linalg.solve(covariance, error))
