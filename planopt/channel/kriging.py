"""Kriging: mean and standard deviation of the power at places, from a posterior.

With a factor every measurement counts. Without one the nearest do
(:mod:`planopt.channel.local_channel`). Covariances of a map's many places are solved for in
place, block by block.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.cholesky import lower_inverse, multiply_rows, solve_rows, whiten
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


PLACES_AT_ONCE = 512
"""Their covariances then stay in the processor's cache."""

INVERT_BELOW = 256
"""With fewer measurements places are multiplied by the factor's inverse: solving runs at 0.6 of the
speed of a matrix product there, at 1,000 measurements at 0.9 of it."""


class RowWhitener:
    """L^-1 applied to rows, and what it tells of y, Gamma and the variance."""

    def __init__(self, lower: NDArray[np.float64], columns: NDArray[np.float64]) -> None:
        self._lower = np.asfortranarray(lower)
        self._columns = np.ascontiguousarray(columns.T)
        self._inverted = len(lower) < INVERT_BELOW
        if self._inverted:
            self._lower = lower_inverse(self._lower)

    def reduce(self, rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Phi' U^-1 [y, Gamma], ``(3, k)``, and the diagonal of Phi' U^-1 Phi, ``(k,)``.

        `rows` (k, n), Phi' in C's order, are overwritten.
        """
        (multiply_rows if self._inverted else solve_rows)(self._lower, rows)
        # One at a time: a product with three columns takes twice as long.
        return np.stack([rows @ column for column in self._columns]), np.vecdot(rows, rows)


PREDICTION_ELEMENTS = 2**21

MANY_PLACES = 1024
"""From so many places on they are solved for in place
(:mod:`planopt.channel.kriging`): a map takes half as long."""


def predict(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,  # (n, 2); memory stays bounded whatever n
    position_std_m: NDArray[np.float64] | None = None,  # (n,)
) -> Prediction:
    """Predict mean and standard deviation of the power that would be measured (equation 1.8).

    From all measurements where `posterior` has a factor, else from the `NEIGHBOURS_BEYOND` nearest
    to each place and theta from all.
    """
    places = require_places(positions_m, at_least=0)
    return combine(
        kriging_terms(posterior, places, position_std_m),
        posterior.theta,
        posterior.theta_covariance,
    )


def kriging_terms(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    position_std_m: NDArray[np.float64] | None = None,
) -> KrigingTerms:
    """The parts of a prediction at `positions_m` (n, 2) that do not depend on theta.

    `position_std_m` as in :func:`predict`.
    """
    if not posterior.has_factor:
        return nearby_terms(posterior, positions_m, NEIGHBOURS_BEYOND, position_std_m)
    count = len(positions_m)
    parameters = posterior.parameters
    measured = posterior.origins
    known = len(posterior.measurements)
    many = count >= MANY_PLACES and known > 0
    columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
    whitener = RowWhitener(posterior.factor, columns) if many else None
    projected = np.empty((3, count))
    explained = np.empty(count)
    block = PLACES_AT_ONCE if many else max(1, PREDICTION_ELEMENTS // max(1, known))
    for start in range(0, count, block):
        part = slice(start, start + block)
        std_m = None if position_std_m is None else position_std_m[part]
        places = place_origins(positions_m[part], posterior.now_s, parameters, std_m)
        if whitener is None:
            whitened = whiten(posterior.factor, covariance_db2(measured, places, parameters))
            projected[:, part] = columns.T @ whitened
            explained[part] = np.einsum("ij,ij->j", whitened, whitened)
        else:
            rows = covariance_db2(places, measured, parameters)
            projected[:, part], explained[part] = whitener.reduce(rows)
    trend = regressors(positions_m, parameters.station) - projected[1:].T
    # Rounding alone can make the latent variance negative, at a place that is known exactly.
    latent = np.maximum(parameters.shadow_std_db**2 - explained, 0.0)
    variance = latent + parameters.multipath_std_db**2
    if position_std_m is not None:
        variance += path_loss_variance_db2(
            positions_m, position_std_m, parameters.station, float(posterior.theta[1])
        )
    return KrigingTerms(projected[0], trend, variance)


def predict_noiseless(posterior: ChannelPosterior, more: Measurements) -> Prediction:
    """Predict measurements without multipath, with offset and position error."""
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
        beside = regressors(posterior.measurements.positions_m[near], parameters.station)
        latent = own_variance_db2(origins, parameters) - np.vecdot(weights, across[:, 0])
        data = np.vecdot(weights, posterior.values_db[near])
        trend = gamma - np.einsum("km,kmi->ki", weights, beside)
    variance = np.maximum(latent, 0.0) + measured_path_loss_variance_db2(more, parameters)
    return combine(KrigingTerms(data, trend, variance), posterior.theta, posterior.theta_covariance)
