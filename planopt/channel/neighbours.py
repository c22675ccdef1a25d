"""Prediction from the nearest measurements only, at a cost that does not grow with their number.

A solver evaluates the channel near a few places again and again: each stage of a plan gets the
`count` measurements nearest to its warm start, their precision matrix and weights as numbers.
Kriging from fewer measurements is a true posterior of less data: its variance is never smaller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.parameters import ChannelParameters
from planopt.channel.path_loss import regressors
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms, Prediction, combine

PADDING_DISTANCE_M = 1e7
"""Where there are fewer measurements than asked for, the rest stands this far from the centre."""


@dataclass(frozen=True, eq=False)
class NeighbourModel:
    """Local kriging about k centres from m measurements each, as arrays of fixed shape.

    With phi_i(q) = xi^2 exp(-|q - position_i| / beta) the prediction at q is
    ``gamma theta + phi' (weights - trend theta)`` and
    ``xi^2 + omega^2 - phi' precision phi + b' M b`` with ``b = gamma - trend' phi``.

    Attributes
    ----------
    positions_m
        ``(k, m, 2)`` the measurements' positions.
    precision
        ``(k, m, m)`` U_mm^-1.
    weights
        ``(k, m)`` U_mm^-1 y.
    trend
        ``(k, m, 2)`` A = U_mm^-1 Gamma_m.
    theta, theta_covariance
        ``(2,)`` and ``(2, 2)``: (K_PL, n_PL) and M, from all measurements.
    parameters
        The channel's parameters.
    """

    positions_m: NDArray[np.float64]
    precision: NDArray[np.float64]
    weights: NDArray[np.float64]
    trend: NDArray[np.float64]
    theta: NDArray[np.float64]
    theta_covariance: NDArray[np.float64]
    parameters: ChannelParameters


def neighbour_model(
    posterior: ChannelPosterior, centres_m: NDArray[np.float64], count: int
) -> NeighbourModel:
    """Prepare local kriging about `centres_m` (k, 2) from the `count` nearest measurements.

    The result has `count` measurements for each centre whatever there is: those that are missing
    stand `PADDING_DISTANCE_M` away with unit precision and no weight, and contribute nothing.
    """
    there = min(count, len(posterior.measurements))
    centres = np.asarray(centres_m, dtype=np.float64)
    indices, _ = nearest(posterior.measurements.positions_m, centres, there)
    precision, weighted = local_precision(posterior, indices)
    missing = count - there
    positions = posterior.measurements.positions_m[indices]
    if missing:
        padding = np.repeat((centres + PADDING_DISTANCE_M)[:, None], missing, axis=1)
        positions = np.concatenate([positions, padding], axis=1)
        padded = np.zeros((len(centres), count, count))
        padded[:, :there, :there] = precision
        padded[:, range(there, count), range(there, count)] = 1.0
        precision = padded
        weighted = np.pad(weighted, ((0, 0), (0, missing), (0, 0)))
    return NeighbourModel(
        positions,
        precision,
        np.ascontiguousarray(weighted[:, :, 0]),
        np.ascontiguousarray(weighted[:, :, 1:]),
        posterior.theta,
        posterior.theta_covariance,
        posterior.parameters,
    )


def predict_locally(model: NeighbourModel, positions_m: NDArray[np.float64]) -> Prediction:
    """Predict power at one place for each centre, ``positions_m`` (k, 2)."""
    places = positions_m[:, None, :]
    terms = local_terms(
        model.parameters,
        places,
        shadow_covariance_db2(places, model.positions_m, model.parameters),
        model.precision,
        np.concatenate([model.weights[:, :, None], model.trend], axis=2),
    )
    prediction = combine(terms, model.theta, model.theta_covariance)
    return Prediction(prediction.mean_db[:, 0], prediction.deviation_db[:, 0])


def nearest(
    positions_m: NDArray[np.float64], centres_m: NDArray[np.float64], count: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """The `count` positions nearest to each centre, in no order, and how far the farthest is.

    Returns
    -------
    tuple
        Indices ``(k, count)`` and squared distances ``(k,)`` in m^2; infinite where all
        positions were taken, because the next one will be taken too.
    """
    total = len(positions_m)
    if count >= total:
        everyone = np.broadcast_to(np.arange(total), (len(centres_m), total))
        return everyone, np.full(len(centres_m), np.inf)
    dx = centres_m[:, None, 0] - positions_m[None, :, 0]
    dy = centres_m[:, None, 1] - positions_m[None, :, 1]
    squared = dx * dx + dy * dy
    indices = np.argpartition(squared, count - 1, axis=1)[:, :count]
    # Partitioning leaves the farthest of the chosen in the last column.
    farthest = np.take_along_axis(squared, indices[:, -1:], axis=1)[:, 0]
    return indices, farthest


def local_precision(
    posterior: ChannelPosterior, indices: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """U_mm^-1 (k, m, m) and U_mm^-1 [y, Gamma_m] (k, m, 3) of the measurements `indices` (k, m)."""
    positions = posterior.measurements.positions_m[indices]
    covariance = shadow_covariance_db2(positions, positions, posterior.parameters)
    np.einsum("kii->ki", covariance)[...] += posterior.noise_variance_db2[indices]
    precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    columns = np.empty((*indices.shape, 3))
    columns[:, :, 0] = posterior.values_db[indices]
    columns[:, :, 1:] = regressors(positions, posterior.parameters.station)
    return precision, precision @ columns


def local_terms(
    parameters: ChannelParameters,
    places_m: NDArray[np.float64],
    across: NDArray[np.float64],
    precision: NDArray[np.float64],
    weighted: NDArray[np.float64],
) -> KrigingTerms:
    """Kriging terms at `places_m` (k, p, 2), each from its own m measurements; shapes (k, p).

    Parameters
    ----------
    parameters
        The channel's parameters.
    places_m
        Where to predict.
    across
        ``(k, p, m)`` covariance of shadowing between places and measurements.
    precision, weighted
        What :func:`local_precision` gives.
    """
    projected = across @ weighted
    trend = regressors(places_m, parameters.station) - projected[:, :, 1:]
    explained = np.einsum("kpm,kpm->kp", across @ precision, across)
    # Rounding alone can make the latent variance negative, at a place that is known exactly.
    latent = np.maximum(parameters.shadow_std_db**2 - explained, 0.0)
    return KrigingTerms(projected[:, :, 0], trend, latent + parameters.multipath_std_db**2)
