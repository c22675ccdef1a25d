"""Prediction from the nearest measurements only, at a cost that does not grow with their number.

A solver evaluates the channel near a few places again and again: each stage of a plan gets the
`count` measurements nearest to its warm start, their precision matrix and weights as numbers.
Kriging from fewer measurements is a true posterior of less data: its variance is never smaller.
Theta and the receivers' offsets are those of all measurements, with their uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import inverse, lower_factor
from planopt.channel.measurement_covariance import ageing, own_covariance_db2
from planopt.channel.offsets import OffsetsGivenTheta, offsets_given_theta
from planopt.channel.parameters import ChannelParameters, regressors
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms

PADDING_DISTANCE_M = 1e7
"""Where there are fewer measurements than asked for, the rest stands this far from the centre."""


@dataclass(frozen=True, eq=False)
class NeighbourModel:
    """Local kriging about k centres from m measurements each, as arrays of fixed shape.

    With phi_i(q) = xi^2 exp(-sqrt(|q - position_i|^2 + blur_i) / beta) the prediction at q is
    ``gamma theta + phi' (weights - trend theta)`` and
    ``xi^2 + omega^2 - phi' precision phi + b' M b`` with ``b = gamma - trend' phi``. The age of
    measurements is in the numbers: with a_i its factor they are a_i P_ij a_j and a_i w_i.
    """

    positions_m: NDArray[np.float64]  # (k, m, 2) the measurements' positions
    blur_m2: NDArray[np.float64]  # (k, m) of errors of these positions
    precision: NDArray[np.float64]  # (k, m, m) U_mm^-1
    weights: NDArray[np.float64]  # (k, m) U_mm^-1 y
    trend: NDArray[np.float64]  # (k, m, 2) A = U_mm^-1 Gamma_m
    theta: NDArray[np.float64]  # (2,) and (2, 2): (K_PL, n_PL) and M, from all measurements
    theta_covariance: NDArray[np.float64]
    parameters: ChannelParameters  # The channel's parameters


def neighbour_model(
    posterior: ChannelPosterior, centres_m: NDArray[np.float64], count: int
) -> NeighbourModel:
    """Prepare local kriging about `centres_m` (k, 2) from the `count` nearest measurements.

    The result has `count` measurements for each centre whatever there is: those that are missing
    stand `PADDING_DISTANCE_M` away with unit precision and no weight, and contribute nothing.
    """
    there = min(count, len(posterior.measurements))
    centres = np.asarray(centres_m, dtype=np.float64)
    indices, _ = posterior.index.nearest(centres, there)
    precision, weighted = local_precision(posterior, offsets_given_theta(posterior), indices)
    missing = count - there
    origins = posterior.origins
    positions = origins.positions_m[indices]
    blur = np.zeros((len(centres), count))
    if origins.blur_m2 is not None:
        blur[:, :there] = origins.blur_m2[indices]
    if origins.time_s is not None:
        aged = ageing(origins.time_s[indices], posterior.now_s, posterior.parameters)
        precision *= aged[:, :, None] * aged[:, None, :]
        weighted *= aged[:, :, None]
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
        blur,
        precision,
        np.ascontiguousarray(weighted[:, :, 0]),
        np.ascontiguousarray(weighted[:, :, 1:]),
        posterior.theta,
        posterior.theta_covariance,
        posterior.parameters,
    )


def local_precision(
    posterior: ChannelPosterior, offsets: OffsetsGivenTheta, indices: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """U_mm^-1 (k, m, m) and U_mm^-1 [y, Gamma_m] (k, m, 3) of the measurements `indices` (k, m).

    With P the inverse for known offsets, o their means and V their covariance given theta, the
    columns are those of P ([y, Gamma] - Z o), and the precision is P - P Z V Z' P: what theta's
    estimate and M are to the mean, o and V are to the readings of receivers.
    """
    origins = posterior.origins.at(indices).without_offsets()
    covariance = own_covariance_db2(origins, posterior.parameters)
    np.einsum("kii->ki", covariance)[...] += posterior.noise_variance_db2[indices]
    if len(covariance) == 1:
        # Of one large matrix the factor costs half; of many small ones the batch does.
        precision = inverse(lower_factor(covariance[0]))[None]
    else:
        precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    columns = np.empty((*indices.shape, 3))
    columns[:, :, 0] = posterior.values_db[indices]
    columns[:, :, 1:] = regressors(origins.positions_m, posterior.parameters.station)
    if not len(offsets.receivers):
        return precision, precision @ columns
    received = offsets.indicators(posterior.measurements.receiver[indices])
    weighted = precision @ (columns - received @ offsets.means_db)
    projected = precision @ received
    precision -= projected @ offsets.covariance_db2 @ projected.swapaxes(1, 2)
    return precision, weighted


def local_terms(
    parameters: ChannelParameters,
    places_m: NDArray[np.float64],
    across: NDArray[np.float64],  # (k, p, m)
    precision: NDArray[np.float64],
    weighted: NDArray[np.float64],
) -> KrigingTerms:
    """Kriging terms at `places_m` (k, p, 2), each from its own m measurements; shapes (k, p)."""
    projected = across @ weighted
    trend = regressors(places_m, parameters.station) - projected[:, :, 1:]
    explained = np.einsum("kpm,kpm->kp", across @ precision, across)
    # Rounding alone can make the latent variance negative, at a place that is known exactly.
    latent = np.maximum(parameters.shadow_std_db**2 - explained, 0.0)
    return KrigingTerms(projected[:, :, 0], trend, latent + parameters.multipath_std_db**2)
