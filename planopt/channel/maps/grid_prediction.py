"""Kriging on a grid, where rows and columns share their coordinate differences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kriging import MANY_PLACES, predict
from planopt.channel.maps.many_places import PLACES_AT_ONCE, RowWhitener
from planopt.channel.measurement_covariance import covariance_over_db2, place_origins
from planopt.channel.path_loss import regressors
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms, Prediction, combine


def predict_grid(
    posterior: ChannelPosterior, x_m: NDArray[np.float64], y_m: NDArray[np.float64]
) -> Prediction:
    """Mean and deviation at all places of a grid; what `predict` gives, sooner.

    Parameters
    ----------
    posterior
        The channel given measurements.
    x_m, y_m
        ``(nx,)`` and ``(ny,)`` the grid's coordinates.

    Returns
    -------
    Prediction
        ``(ny, nx)``.
    """
    shape = (len(y_m), len(x_m))
    places = np.stack(np.meshgrid(x_m, y_m), axis=-1).reshape(-1, 2)
    known = len(posterior.measurements)
    if len(places) < MANY_PLACES or not known or not posterior.has_factor:
        found = predict(posterior, places)
        return Prediction(found.mean_db.reshape(shape), found.deviation_db.reshape(shape))
    parameters, measured = posterior.parameters, posterior.origins
    # All are of the same time and have no position error; which one it is does not matter.
    anywhere = place_origins(places[:1], posterior.now_s, parameters)
    columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
    whitener = RowWhitener(posterior.factor, columns)
    square_x = (np.asarray(x_m)[:, None] - measured.positions_m[:, 0]) ** 2
    square_y = (np.asarray(y_m)[:, None] - measured.positions_m[:, 1]) ** 2
    if measured.blur_m2 is not None:
        square_y += measured.blur_m2
    projected, explained = np.empty((3, *shape)), np.empty(shape)
    across = min(shape[1], PLACES_AT_ONCE)
    along = max(1, PLACES_AT_ONCE // across)
    spare = np.empty((along, across, known))
    for left in range(0, shape[1], across):
        for low in range(0, shape[0], along):
            part = np.s_[low : low + along, left : left + across]
            size = explained[part].shape
            square = np.add(
                square_y[part[0], None], square_x[None, part[1]], out=spare[: size[0], : size[1]]
            )
            # A last block that is narrower is copied, the others are not.
            distance = np.sqrt(square, out=square).reshape(-1, known)
            rows = covariance_over_db2(distance, anywhere, measured, parameters)
            found, said = whitener.reduce(rows)
            projected[:, *part], explained[part] = found.reshape(3, *size), said.reshape(size)
    trend = regressors(places, parameters.station).reshape(*shape, 2)
    trend -= np.moveaxis(projected[1:], 0, -1)
    # Rounding alone can make the latent variance negative, at a place that is known exactly.
    latent = np.maximum(parameters.shadow_std_db**2 - explained, 0.0)
    terms = KrigingTerms(projected[0], trend, latent + parameters.multipath_std_db**2)
    return combine(terms, posterior.theta, posterior.theta_covariance)
