"""Joint prediction of power at several positions: moments, samples, outage and delivered data.

Packets are sent at the path's positions, with independent multipath. A leg is connected if its end
position is, as in the metrics of the closed loop.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planopt.arrays import Floats, Mask
from planopt.channel.cholesky import semidefinite_factor, whiten
from planopt.channel.gaussian_sites import rounded_variance_db2
from planopt.channel.kriging import (
    CONFIDENCE,
    Prediction,
    binomial_interval,
    bound_quantile,
    predict_noiseless,
)
from planopt.channel.measurements import Measurements, shadow_covariance_db2
from planopt.channel.parameter_uncertainty import MarginalPosterior, mixture
from planopt.channel.parameters import (
    leg_lengths_m,
    regressors,
    require_count,
    require_finite,
    require_places,
)
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class JointPrediction:
    """Jointly Gaussian powers at h positions.

    Attributes
    ----------
    mean_db
        ``(h,)`` mean mu in dBm.
    covariance_db2
        ``(h, h)`` symmetric covariance in dB^2 (equations 1.11 and 1.12).

    Raises
    ------
    InputError
        There is no position, shapes differ, or a number is not finite.
    """

    mean_db: Floats
    covariance_db2: Floats

    __repr__ = short_repr

    def __post_init__(self) -> None:
        count = len(self.mean_db)
        if count == 0 or self.covariance_db2.shape != (count, count):
            raise InputError(
                f"the mean has shape {self.mean_db.shape} and the covariance "
                f"{self.covariance_db2.shape}; they do not match",
                remedy="give (h,) and (h, h) with h at least 1",
            )
        if not (np.isfinite(self.mean_db).all() and np.isfinite(self.covariance_db2).all()):
            raise InputError("the predicted mean or covariance contains NaN or infinite values")

    def __len__(self) -> int:
        return len(self.mean_db)

    @property
    def deviation_db(self) -> Floats:
        """Standard deviation at each position, ``(h,)``."""
        return np.sqrt(np.diag(self.covariance_db2))

    def sample(self, count: int, generator: np.random.Generator) -> Floats:
        """Draw powers ``(count, h)`` in dBm."""
        lower = semidefinite_factor(self.covariance_db2)
        draws = generator.standard_normal((require_count(count, "count"), len(self)))
        return self.mean_db + draws @ lower.T


def joint_prediction(
    posterior: ChannelPosterior, positions_m: ArrayLike, *, latent: bool = False
) -> JointPrediction:
    """Return mean and covariance of the powers at `positions_m`, from all measurements.

    The covariance is S + B M B' with S = K + omega^2 I - Phi' U^-1 Phi and
    B = Gamma_h - Phi' U^-1 Gamma (equations 1.11 and 1.12; M is zero if theta is known). Its
    diagonal agrees with :func:`planopt.channel.kriging.predict`. Memory grows with h (kappa + h).

    Parameters
    ----------
    posterior
        Channel conditional on measurements.
    positions_m
        ``(h, 2)`` positions in metres. Multipath is independent, even at a repeated position.
    latent
        True to predict the power without multipath.

    Raises
    ------
    InputError
        `positions_m` is not a path.
    """
    terms = joint_terms(posterior, require_places(positions_m))
    covariance = terms.latent_db2
    if not latent:
        covariance[np.diag_indices_from(covariance)] += posterior.parameters.multipath_std_db**2
    covariance += terms.trend @ posterior.theta_covariance @ terms.trend.T
    return JointPrediction(
        terms.data_db + terms.trend @ posterior.theta, 0.5 * (covariance + covariance.T)
    )


@dataclass(frozen=True, eq=False)
class JointTerms:
    """Terms of a joint prediction that do not depend on the path loss theta."""

    data_db: Floats  # (h,) Phi' U^-1 Y
    trend: Floats  # (h, 2) B
    latent_db2: Floats  # (h, h) S without multipath


def joint_terms(posterior: ChannelPosterior, places_m: Floats) -> JointTerms:
    """Return the terms of a joint prediction at positions (h, 2)."""
    parameters = posterior.parameters
    across = whiten(posterior.factor, posterior.covariance_with_db2(places_m))
    covariance = shadow_covariance_db2(places_m, places_m, parameters) - across.T @ across
    own = np.diag_indices_from(covariance)
    # Rounding errors can make the latent variance negative at a noise-free measured position.
    covariance[own] = np.maximum(covariance[own], 0.0)
    return JointTerms(
        across.T @ posterior.whitened_values,
        regressors(places_m, parameters.station) - across.T @ posterior.whitened_regressors,
        covariance,
    )


def sample_power(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,
    count: int,
    generator: np.random.Generator,
    *,
    latent: bool = False,
) -> Floats:
    """Draw powers at `positions_m` from the posterior, in dBm as an array ``(count, h)``.

    Parameters
    ----------
    posterior
        Channel conditional on measurements.
    positions_m
        ``(h, 2)`` positions in metres.
    count
        Number of draws.
    generator
        Random number generator.
    latent
        True to draw the power without multipath.

    Raises
    ------
    InputError
        `positions_m` is not a path, or `count` is below one.
    """
    return joint_prediction(posterior, positions_m, latent=latent).sample(count, generator)


def predict_readings(
    posterior: ChannelPosterior | MarginalPosterior, readings: Measurements
) -> Prediction:
    """Predict the powers of further measurements.

    Parameters
    ----------
    posterior
        Channel conditional on other measurements.
    readings
        n measurements. Their positions, times, receivers, resolution and position errors are used,
        their powers are not.

    Returns
    -------
    Prediction
        Predicted readings in the same order. For exact, unrounded readings of receiver 0 in a
        static channel it is the posterior's prediction at their positions.
    """
    if isinstance(posterior, MarginalPosterior):
        parts = [predict_readings(component, readings) for component in posterior.components]
        return mixture(posterior.weights, parts)
    found = predict_noiseless(posterior, readings)
    variance = found.deviation_db**2 + posterior.parameters.white_variance_db2
    variance += rounded_variance_db2(readings.resolution_db)
    return Prediction(found.mean_db, np.sqrt(variance))


@dataclass(frozen=True)
class Interval:
    """Point estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class SampledDistribution:
    """Distribution of one number, represented by independent draws.

    Attributes
    ----------
    draws
        ``(count,)`` draws in the order drawn, at least 2.
    """

    draws: Floats

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.draws.ndim != 1 or len(self.draws) < 2:
            raise InputError(
                f"is {self.draws.shape[0]}, should be at least 2",
                key="count",
                remedy="give a larger number of draws",
            )

    @property
    def count(self) -> int:
        """Return the number of draws."""
        return len(self.draws)

    def mean(self) -> Interval:
        """Return the mean with its confidence interval from the central limit theorem."""
        value = float(self.draws.mean())
        half = _half_width() * float(self.draws.std(ddof=1)) / math.sqrt(self.count)
        return Interval(value, value - half, value + half)

    def quantile(self, share: float) -> Interval:
        """Return the quantile at probability `share`, with its interval from order statistics.

        Raises
        ------
        InputError
            `share` is not from 0 to 1.
        """
        if not 0.0 <= share <= 1.0:
            raise InputError(
                f"is {share!r}, should be a probability",
                key="share",
                remedy="give a number from 0 to 1",
            )
        half = _half_width() * math.sqrt(share * (1.0 - share) / self.count)
        shares = np.clip([share, share - half, share + half], 0.0, 1.0)
        value, low, high = np.quantile(self.draws, shares, method="inverted_cdf").tolist()
        return Interval(value, low, high)

    def exceedance(self, limit: float) -> Interval:
        """Return P(value > `limit`) with its Clopper-Pearson interval."""
        above = float((self.draws > limit).sum())
        return Interval(above / self.count, *binomial_interval(above, self.count))


def _half_width() -> float:
    """Return the half-width of a normal confidence interval in standard deviations."""
    return bound_quantile(0.5 + 0.5 * CONFIDENCE)


@dataclass(frozen=True)
class Traffic:
    """Fluid model of the data to send: source, buffer and link.

    Attributes
    ----------
    link_bps
        Link rate while connected, above 0.
    waiting_bits
        Initial content of the buffer.
    source_bps
        Arrival rate of new data.
    buffer_bits
        Capacity of the buffer; the excess is lost.

    Raises
    ------
    InputError
        A number is negative or NaN, or `waiting_bits` exceeds the buffer.
    """

    link_bps: float
    waiting_bits: float = 0.0
    source_bps: float = 0.0
    buffer_bits: float = math.inf

    def __post_init__(self) -> None:
        if not 0.0 < self.link_bps < math.inf:
            raise InputError(
                f"is {self.link_bps!r}, should be a rate in bit/s above 0",
                key="link_bps",
                remedy="give e.g. 1e6",
            )
        if not 0.0 <= self.source_bps < math.inf:
            raise InputError(
                f"is {self.source_bps!r}, should be a rate in bit/s of at least 0",
                key="source_bps",
                remedy="give e.g. 1e5",
            )
        if not 0.0 <= self.waiting_bits < math.inf or not self.waiting_bits <= self.buffer_bits:
            raise InputError(
                f"is {self.waiting_bits!r}, but the buffer size is {self.buffer_bits!r} bits",
                key="waiting_bits",
                remedy="give at least 0 bits and at most buffer_bits",
            )


@dataclass(frozen=True, eq=False)
class LongestOutage:
    """Longest outage along a path; draw k of both attributes is from the same sampled channel.

    Attributes
    ----------
    metres
        Length of the longest outage by distance.
    seconds
        Duration of the longest outage by time.
    """

    metres: SampledDistribution
    seconds: SampledDistribution

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class DeliveredData:
    """Data delivered by a deadline; draw k of all attributes is from the same sampled channel.

    Attributes
    ----------
    delivered_bits
        Data received by the deadline.
    lost_bits
        Data lost because the buffer was full.
    waiting_bits
        Data still in the buffer at the deadline.
    """

    delivered_bits: SampledDistribution
    lost_bits: SampledDistribution
    waiting_bits: SampledDistribution

    __repr__ = short_repr


def longest_outage(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,
    times_s: ArrayLike,
    threshold_dbm: float,
    count: int,
    generator: np.random.Generator,
) -> LongestOutage:
    """Return the distribution of the longest outage along a path.

    Parameters
    ----------
    posterior
        Channel conditional on measurements.
    positions_m
        ``(h, 2)`` positions in metres, h >= 2, where packets are sent; the first is the start.
    times_s
        ``(h,)`` times at these positions, increasing.
    threshold_dbm
        Minimum power for a connection.
    count
        Number of sampled channels, at least 2.
    generator
        Random number generator.

    Raises
    ------
    InputError
        An argument is invalid.
    """
    places, times = _path(positions_m, times_s)
    missed = ~_connected(posterior, places, threshold_dbm, count, generator)[:, 1:]
    return LongestOutage(
        SampledDistribution(longest_run(leg_lengths_m(places), missed)),
        SampledDistribution(longest_run(np.diff(times), missed)),
    )


def delivered_data(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,
    times_s: ArrayLike,
    threshold_dbm: float,
    traffic: Traffic,
    deadline_s: float,
    count: int,
    generator: np.random.Generator,
) -> DeliveredData:
    """Return the distribution of the data delivered by a deadline along a path.

    Parameters
    ----------
    posterior, positions_m, times_s, threshold_dbm, count, generator
        As in :func:`longest_outage`.
    traffic
        Rates and buffer.
    deadline_s
        Deadline between the first and the last of `times_s`.

    Raises
    ------
    InputError
        An argument is invalid.
    """
    places, times = _path(positions_m, times_s)
    if not times[0] <= deadline_s <= times[-1]:
        raise InputError(
            f"is {deadline_s!r} s, but the path lasts from {times[0]:g} to {times[-1]:g} s",
            key="deadline_s",
            remedy="give a deadline within that time, or repeat the last position at later "
            "times if the robot waits",
        )
    connected = _connected(posterior, places, threshold_dbm, count, generator)
    durations = np.diff(np.minimum(times, deadline_s))
    delivered, lost, waiting = sent_and_lost(durations, connected, traffic)
    return DeliveredData(
        SampledDistribution(delivered), SampledDistribution(lost), SampledDistribution(waiting)
    )


def longest_run(sizes: Floats, missed: Mask, begun: float = 0.0) -> Floats:
    """Return the largest sum of `sizes` over consecutive `missed` steps; both are (..., N)."""
    # `begun` is added to a sequence that begins with the first step.
    longest, run = np.zeros(missed.shape[:-1]), np.full(missed.shape[:-1], begun)
    for step in range(missed.shape[-1]):
        run = np.where(missed[..., step], run + sizes[..., step], 0.0)
        longest = np.maximum(longest, run)
    return longest


def sent_and_lost(
    durations_s: Floats,  # (h - 1,)
    connected: Mask,  # (count, h)
    traffic: Traffic,
) -> tuple[Floats, Floats, Floats]:
    """Return the bits (count,) delivered, lost, and left in the buffer."""
    # This is exact for a fluid: rates are constant on a leg, so its buffer level is monotonic.
    waiting = np.full(len(connected), traffic.waiting_bits)
    delivered = np.zeros(len(connected))
    lost = np.zeros(len(connected))
    for duration, now in zip(durations_s, connected[:, 1:].T, strict=True):
        offered = waiting + traffic.source_bps * duration
        sent = np.where(now, np.minimum(traffic.link_bps * duration, offered), 0.0)
        waiting = np.minimum(offered - sent, traffic.buffer_bits)
        delivered += sent
        lost += offered - sent - waiting
    return delivered, lost, waiting


def _path(positions_m: ArrayLike, times_s: ArrayLike) -> tuple[Floats, Floats]:
    """Return validated positions and times."""
    places = require_places(positions_m, 2)
    times = np.asarray(times_s, dtype=np.float64)
    if times.shape != (len(places),):
        raise InputError(
            f"has shape {times.shape} for {len(places)} positions",
            key="times_s",
            remedy="give one time for each position",
        )
    if not np.isfinite(times).all() or not (np.diff(times) > 0.0).all():
        raise InputError(
            "must be finite and increasing", key="times_s", remedy="sort the positions by time"
        )
    return places, times


def _connected(
    posterior: ChannelPosterior,
    places_m: Floats,
    threshold_dbm: float,
    count: int,
    generator: np.random.Generator,
) -> Mask:
    """Draw `count` sets of connection states (count, h) at positions (h, 2)."""
    threshold = require_finite(threshold_dbm, "threshold_dbm")
    return sample_power(posterior, places_m, count, generator) >= threshold
