"""Kriging: mean and standard deviation of the power at places, from a posterior.

With a factor predictions use all measurements, without one the nearest
(:mod:`planopt.channel.local_channel`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.cholesky import whiten
from planopt.channel.local_channel import NEIGHBOURS_BEYOND, nearby_terms
from planopt.channel.measurement_covariance import (
    covariance_db2,
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
    own_variance_db2,
    path_loss_variance_db2,
    place_origins,
)
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import regressors, require_places
from planopt.channel.prediction import KrigingTerms, Prediction, combine
from planopt.channel.vecchia import EARLIER_NEIGHBOURS

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior


PREDICTION_ELEMENTS = 2**17
"""Target number of covariances in a block of a large prediction, which then stays in cache."""

LEAST_BLOCK = 256


def predict(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,  # (n, 2); memory stays bounded whatever n
    position_std_m: NDArray[np.float64] | None = None,  # (n,)
) -> Prediction:
    """Predict mean and standard deviation of the power that would be measured (equation 1.8).

    Uses all measurements if `posterior` has a factor, else the `NEIGHBOURS_BEYOND` nearest to each
    place and the theta of all.
    """
    places = require_places(positions_m, at_least=0)
    terms = kriging_terms(posterior, places, position_std_m)
    return combine(terms, posterior.theta, posterior.theta_covariance)


def kriging_terms(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],  # (n, 2)
    position_std_m: NDArray[np.float64] | None = None,  # (n,)
) -> KrigingTerms:
    """Return the parts of a prediction that do not depend on theta."""
    if not posterior.has_factor:
        return nearby_terms(posterior, positions_m, NEIGHBOURS_BEYOND, position_std_m)
    count, known = len(positions_m), len(posterior.measurements)
    parameters = posterior.parameters
    columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
    projected = np.empty((3, count))
    explained = np.empty(count)
    block = max(LEAST_BLOCK, PREDICTION_ELEMENTS // max(1, known))
    for start in range(0, count, block):
        part = slice(start, start + block)
        std_m = None if position_std_m is None else position_std_m[part]
        places = place_origins(positions_m[part], posterior.now_s, parameters, std_m)
        across = covariance_db2(posterior.origins, places, parameters)
        whitened = whiten(posterior.factor, across)
        projected[:, part] = columns.T @ whitened
        explained[part] = np.einsum("ij,ij->j", whitened, whitened)
    trend = regressors(positions_m, parameters.station) - projected[1:].T
    # Rounding can make the latent variance negative at a place that is known exactly.
    latent = np.maximum(parameters.shadow_std_db**2 - explained, 0.0)
    variance = latent + parameters.multipath_std_db**2
    if position_std_m is not None:
        variance += path_loss_variance_db2(
            positions_m, position_std_m, parameters.station, float(posterior.theta[1])
        )
    return KrigingTerms(projected[0], trend, variance)


def predict_noiseless(posterior: ChannelPosterior, more: Measurements) -> Prediction:
    """Predict measurements without multipath, but with their offsets and position errors."""
    parameters = posterior.parameters
    origins = measured_origins(more, parameters)
    gamma = regressors(more.positions_m, parameters.station)
    if posterior.has_factor:
        whitened = whiten(posterior.factor, covariance_db2(posterior.origins, origins, parameters))
        latent = own_variance_db2(origins, parameters) - np.einsum("ij,ij->j", whitened, whitened)
        data = posterior.whitened_values @ whitened
        trend = gamma - whitened.T @ posterior.whitened_regressors
    else:
        near, _ = posterior.index.nearest(more.positions_m, EARLIER_NEIGHBOURS)
        neighbours = posterior.origins.at(near)
        covariance = own_covariance_db2(neighbours, parameters)
        np.einsum("kii->ki", covariance)[...] += posterior.noise_variance_db2[near]
        own = origins.at(np.arange(len(more))[:, None])
        across = covariance_db2(own, neighbours, parameters)
        weights = np.linalg.solve(covariance, across.swapaxes(1, 2))[:, :, 0]
        gamma_near = regressors(posterior.measurements.positions_m[near], parameters.station)
        latent = own_variance_db2(origins, parameters) - np.vecdot(weights, across[:, 0])
        data = np.vecdot(weights, posterior.values_db[near])
        trend = gamma - np.einsum("km,kmi->ki", weights, gamma_near)
    variance = np.maximum(latent, 0.0) + measured_path_loss_variance_db2(more, parameters)
    return combine(KrigingTerms(data, trend, variance), posterior.theta, posterior.theta_covariance)
