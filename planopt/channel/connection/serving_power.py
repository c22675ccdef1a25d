"""Connection to any of several stations: its probability, its margin, and the serving power.

With powers P_i and thresholds t_i, each station's fading its own,

    S = max_i (P_i - t_i) + t_1

is a power that one threshold judges, the first station's: a place is connected to at least one
station if and only if S >= t_1. S is not normal. Everything that works with a mean and a deviation
uses the normal law that agrees with the law of S where it counts:

- the probability of S >= t_1 is that of a connection to any station, exactly;
- so is the power that S exceeds with probability p_min, and with it the margin in dB: the amount by
  which all thresholds may be raised until the bound p_min is just kept.

Station i connects with probability Phi(z_i). With independent stations

    P(any) = 1 - prod (1 - Phi(z_i)) = Phi(z)

defines the score z of them all, which stays informative where P is 0 or 1 to all digits. Logarithms
of both tails are kept, so that z has twelve digits from -1e3 to 1e3. With shared shadowing
:func:`connected_to_any` and :func:`strongest_station` use the joint law of the powers instead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import (  # pyright: ignore[reportUnknownVariableType]
    log_ndtr,
    ndtr,  # pyright: ignore[reportUnknownVariableType]
    ndtri_exp,
)

from planopt.channel.connection.joint_connectivity import prefix_probabilities
from planopt.channel.intervals.censoring import MIN_NOISE_VARIANCE_DB2
from planopt.channel.kriging import predict
from planopt.channel.places import require_finite, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, bound_quantile, connection_probability
from planopt.errors import InputError

LEAST_DEVIATION_DB = math.sqrt(MIN_NOISE_VARIANCE_DB2)
"""Lower bound of deviations in scores, so that a known power at the threshold gives 1/2."""

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


def any_score(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """The score z of any of m stations with scores ``(m, ...)``; ``(...)``, infinite ones included.

    It is at least the largest of the scores, and is that where all others are far below; NaN where
    one of them is.
    """
    return _score(_log_any(scores), _log_normal(-scores).sum(axis=0))


def any_score_derivatives(
    scores: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """z, its gradient ``(m, ...)`` and its Hessian ``(m, m, ...)`` by the scores ``(m, ...)``.

    With phi the normal density, Q = prod (1 - Phi(z_j)) and h_j = phi(z_j) / (1 - Phi(z_j)):

        w_i = dz/dz_i = phi(z_i) / phi(z) prod_{j != i} (1 - Phi(z_j))
        d^2z/dz_i dz_j = w_i (z w_j - h_j),    d^2z/dz_i^2 = w_i (z w_i - z_i)

    Finite scores only.
    """
    none_each = _log_normal(-scores)
    none = none_each.sum(axis=0)
    z = _score(_log_any(scores), none)
    weight = np.exp(0.5 * (z * z - scores * scores) + none - none_each)
    hazard = np.exp(-0.5 * scores * scores - LOG_ROOT_2PI - none_each)
    hessian = weight[:, None] * (z * weight[None] - hazard[None])
    own = np.arange(len(scores))
    hessian[own, own] = weight * (z * weight - scores)
    return z, weight, hessian


def _log_normal(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(log_ndtr(scores), dtype=np.float64)


def _log_any(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log P(any), by P(a or b) = P(a) + P(b) (1 - P(a)): nothing is subtracted."""
    found = _log_normal(scores[0])
    none = _log_normal(-scores[0])
    with np.errstate(invalid="ignore"):  # what is not known stays NaN
        for score in scores[1:]:
            found = np.logaddexp(found, _log_normal(score) + none)
            none = none + _log_normal(-score)
    return found


def _score(log_any: NDArray[np.float64], log_none: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the score from the smaller tail, which has all the digits."""
    low = np.asarray(ndtri_exp(np.minimum(log_any, log_none)), dtype=np.float64)
    return np.where(log_any < log_none, low, -low)


SECANT_FROM_DB = 1e-4
"""Where the margin is smaller, the slope of the score stands for its secant."""

SETTLED_DB = 1e-10
MOST_STEPS = 100
"""Newton's method on the margin ends below the first, some six steps as a rule, and always here."""


def serving_prediction(
    predictions: Sequence[Prediction],
    thresholds_dbm: Sequence[float],
    p_min: float,
) -> Prediction:
    """The normal law that stands for the serving power of m stations at n places."""
    if len(predictions) == 1:
        return predictions[0]
    above, deviation = above_thresholds_db(predictions, thresholds_dbm)
    score, weight, _ = any_score_derivatives(above / deviation)
    spread = 1.0 / (weight / deviation).sum(axis=0)
    if 0.0 < p_min < 1.0:
        margin = any_margin_db(above, deviation, p_min)
        far = np.abs(margin) > SECANT_FROM_DB
        np.divide(margin, score - bound_quantile(p_min), out=spread, where=far)
    return Prediction(thresholds_dbm[0] + spread * score, spread)


def any_probability(
    predictions: Sequence[Prediction],
    thresholds_dbm: Sequence[float],
    slack_db: float = 0.0,
) -> NDArray[np.float64]:
    """P(at least one of m stations connects), all thresholds `slack_db` lower; ``(n,)``."""
    above, deviation = above_thresholds_db(predictions, thresholds_dbm)
    return np.asarray(ndtr(any_score((above + slack_db) / deviation)), dtype=np.float64)


def serving_power_dbm(
    powers_dbm: NDArray[np.float64], thresholds_dbm: Sequence[float]
) -> NDArray[np.float64]:
    """S of known powers ``(m, ...)``; ``(...)``."""
    if len(powers_dbm) == 1:
        return powers_dbm[0]
    offsets = thresholds_dbm[0] - np.asarray(thresholds_dbm)
    return (powers_dbm + offsets.reshape(-1, *[1] * (powers_dbm.ndim - 1))).max(axis=0)


def above_thresholds_db(
    predictions: Sequence[Prediction], thresholds_dbm: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each station's mean above its threshold, and its deviation; ``(m, n)`` both."""
    above = np.stack(
        [
            prediction.mean_db - threshold
            for prediction, threshold in zip(predictions, thresholds_dbm, strict=True)
        ]
    )
    deviation = np.stack([prediction.deviation_db for prediction in predictions])
    return above, np.maximum(deviation, LEAST_DEVIATION_DB)


def any_margin_db(
    above_db: NDArray[np.float64], deviation_db: NDArray[np.float64], p_min: float
) -> NDArray[np.float64]:
    """Return by how much all thresholds may be raised until P(any) is `p_min`; ``(n,)``.

    The score of any station falls with that and is convex, so that Newton's method from the best
    single station's margin comes to it from below. It is held between that and what m stations as
    good as the best would have.
    """
    # Shapes: above_db, deviation_db (m, n).
    wanted = bound_quantile(p_min)
    # One of m that each connect with this probability.
    shared = bound_quantile(-math.expm1(math.log1p(-p_min) / len(above_db)))
    low: NDArray[np.float64] = (above_db - wanted * deviation_db).max(axis=0)
    high: NDArray[np.float64] = (above_db - shared * deviation_db).max(axis=0)
    margin = low.copy()
    open_places = np.flatnonzero(high - low > SETTLED_DB)
    for _ in range(MOST_STEPS):
        if not len(open_places):
            break
        above, deviation = above_db[:, open_places], deviation_db[:, open_places]
        here = margin[open_places]
        score, weight, _ = any_score_derivatives((above - here) / deviation)
        lacking = score - wanted
        low[open_places] = np.where(lacking >= 0.0, here, low[open_places])
        high[open_places] = np.where(lacking < 0.0, here, high[open_places])
        there = here + lacking / (weight / deviation).sum(axis=0)
        between = (there >= low[open_places]) & (there <= high[open_places])
        there = np.where(between, there, 0.5 * (low[open_places] + high[open_places]))
        margin[open_places] = there
        open_places = open_places[np.abs(there - here) > SETTLED_DB]
    return margin


REACH = 8.5
"""The sum over one station's power runs over this many deviations on both sides."""

STEPS_PER_DEVIATION = 2.0
"""Steps in the smallest deviation: sums of Gaussians are then exact to rounding."""

BLOCK_ELEMENTS = 2**20


@dataclass(frozen=True, eq=False)
class SharedShadowing:
    """The correlation of shadowing between stations.

    Attributes
    ----------
    correlation
        ``(m, m)`` between the stations' shadowing at one place, given the measurements: a
        correlation matrix. It is the prior's too where all stations were measured at the same
        places in the same ratio of shadowing to multipath, and theta is known.
    generator
        Source of randomness of the integration that is then needed.
    tolerance
        Accuracy that it tries for.
    """

    correlation: NDArray[np.float64]
    generator: np.random.Generator
    tolerance: float = 1e-4


@dataclass(frozen=True, eq=False)
class StationProbability:
    """Probabilities at places."""

    probability: NDArray[np.float64]  # (n,), or (m, n) for m stations
    error: NDArray[np.float64]  # Three standard errors, same shape; zero where exact


def connected_to_any(
    posteriors: Sequence[ChannelPosterior],
    positions_m: ArrayLike,
    threshold_dbm: float,
    shared: SharedShadowing | None = None,
) -> StationProbability:
    """P(power >= threshold from at least one station) at each place; ``(n,)``.

    Independent: 1 - prod (1 - p_i). With shared shadowing: 1 - Phi_m(threshold - mu; 0, C) with
    C_ij = c_ij s_i s_j off the diagonal, s_i the deviation without multipath, which the stations
    never share.

    Parameters
    ----------
    posteriors
        One for each station, at least one.
    positions_m
        ``(n, 2)`` metres.
    threshold_dbm
        Power from which on a station connects.
    shared
        Shadowing that the stations share; none without it.

    Raises
    ------
    InputError
        There is no station, or an argument cannot be used.
    """
    threshold = require_finite(threshold_dbm, "threshold_dbm")
    mean, deviation = _predictions(posteriors, positions_m)
    if shared is None:
        alone = connection_probability(mean, deviation, threshold)
        found = np.asarray(1.0 - np.prod(1.0 - alone, axis=0), dtype=np.float64)
        return StationProbability(found, np.zeros(len(found)))
    covariances = _covariances(posteriors, deviation, shared)
    missed, error = np.empty(mean.shape[1]), np.empty(mean.shape[1])
    for place, covariance in enumerate(covariances):
        found = prefix_probabilities(
            threshold - mean[:, place], covariance, shared.generator, shared.tolerance
        )
        missed[place], error[place] = found.probability[-1], found.error[-1]
    return StationProbability(1.0 - missed, error)


def strongest_station(
    posteriors: Sequence[ChannelPosterior],
    positions_m: ArrayLike,
    shared: SharedShadowing | None = None,
) -> StationProbability:
    """P(a station's power is the greatest), the station that would serve; ``(m, n)``.

    Independent: int N(t; mu_i, s_i^2) prod_{j != i} Phi((t - mu_j) / s_j) dt by equally spaced
    sums, exact to rounding. With shared shadowing: the chance that all differences to the others
    are positive. Columns sum to one. Arguments and errors as in :func:`connected_to_any`.
    """
    mean, deviation = _predictions(posteriors, positions_m)
    if shared is None:
        return StationProbability(_strongest_alone(mean, deviation), np.zeros_like(mean))
    stations = len(mean)
    if stations == 1:
        return StationProbability(np.ones_like(mean), np.zeros_like(mean))
    probability, error = np.empty_like(mean), np.empty_like(mean)
    for place, covariance in enumerate(_covariances(posteriors, deviation, shared)):
        for station in range(stations):
            # Rows: power of another less power of this one, which must be negative.
            less = np.delete(np.eye(stations), station, axis=0)
            less[:, station] = -1.0
            found = prefix_probabilities(
                -less @ mean[:, place],
                less @ covariance @ less.T,
                shared.generator,
                shared.tolerance,
            )
            probability[station, place] = found.probability[-1]
            error[station, place] = found.error[-1]
    return StationProbability(probability, error)


def _predictions(
    posteriors: Sequence[ChannelPosterior], positions_m: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and deviation of each station's power at each place; two of (m, n)."""
    if not posteriors:
        raise InputError("there is no station", key="posteriors", remedy="give at least one")
    places = require_places(positions_m)
    predictions = [predict(posterior, places) for posterior in posteriors]
    mean = np.stack([prediction.mean_db for prediction in predictions])
    return mean, np.stack([prediction.deviation_db for prediction in predictions])


def _covariances(
    posteriors: Sequence[ChannelPosterior],
    deviation_db: NDArray[np.float64],
    shared: SharedShadowing,
) -> NDArray[np.float64]:
    """Covariance between the stations' powers at each place; (n, m, m)."""
    correlation = np.asarray(shared.correlation, dtype=np.float64)
    stations = len(posteriors)
    if (
        correlation.shape != (stations, stations)
        or not np.isfinite(correlation).all()
        or not np.array_equal(correlation, correlation.T)
        or not (np.diag(correlation) == 1.0).all()
        or np.linalg.eigvalsh(correlation)[0] < -1e-9
    ):
        raise InputError(
            f"{correlation.tolist()!r} is no correlation matrix of {stations} stations",
            key="shared.correlation",
            remedy="symmetric, ones on the diagonal, no negative eigenvalue",
        )
    omega = np.array([posterior.parameters.multipath_std_db for posterior in posteriors])
    latent = np.sqrt(np.maximum(deviation_db.T**2 - omega**2, 0.0))
    covariances = correlation * latent[:, :, None] * latent[:, None, :]
    own = np.arange(stations)
    covariances[:, own, own] = deviation_db.T**2
    return covariances


def _strongest_alone(
    mean_db: NDArray[np.float64], deviation_db: NDArray[np.float64]
) -> NDArray[np.float64]:
    """P(each is the greatest) of independent powers (m, n); (m, n)."""
    # Powers that are known would be steps; so little spread decides ties evenly.
    deviation = np.maximum(deviation_db, math.sqrt(MIN_NOISE_VARIANCE_DB2))
    probability = np.empty_like(mean_db)
    for station in range(len(mean_db)):
        ratio = float((deviation / deviation[station]).min())
        half = math.ceil(REACH * STEPS_PER_DEVIATION / ratio)
        scores = np.arange(-half, half + 1.0) * (REACH / half)
        weights = np.exp(-0.5 * scores * scores)
        weights /= weights.sum()
        others = np.delete(np.arange(len(mean_db)), station)
        block = max(1, BLOCK_ELEMENTS // len(scores))
        for start in range(0, mean_db.shape[1], block):
            part = slice(start, start + block)
            power = mean_db[station, part, None] + deviation[station, part, None] * scores
            greatest = np.ones_like(power)
            for other in others:
                gap = (power - mean_db[other, part, None]) / deviation[other, part, None]
                greatest *= np.asarray(ndtr(gap), dtype=np.float64)
            probability[station, part] = greatest @ weights
    return probability
