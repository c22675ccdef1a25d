"""Connected to any of several stations, and which of them is the strongest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.connection.joint_connectivity import prefix_probabilities
from planopt.channel.intervals.censoring import MIN_NOISE_VARIANCE_DB2
from planopt.channel.kriging import predict
from planopt.channel.places import require_finite, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import connection_probability
from planopt.errors import InputError

REACH = 8.5
"""The sum over one station's power runs over this many deviations on both sides."""

STEPS_PER_DEVIATION = 2.0
"""Steps in the smallest deviation: sums of Gaussians are then exact to rounding."""

BLOCK_ELEMENTS = 2**20


@dataclass(frozen=True, eq=False)
class SharedShadowing:
    """How much shadowing the stations share.

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
    """Probabilities at places.

    Attributes
    ----------
    probability
        ``(n,)``, or ``(m, n)`` for m stations.
    error
        Three standard errors, same shape; zero where exact.
    """

    probability: NDArray[np.float64]
    error: NDArray[np.float64]


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
