"""Kriging over a large map in single precision: half the time of the exact map.

At many measurements a map costs the triangular solve, whose speed is the processor's; in single
precision that is twice as high. Only covariances between places and measurements are rounded: the
factor, the weights and theta come from the posterior as it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import solve_lower_single
from planopt.channel.factor import SOLVE_BLOCK
from planopt.channel.maps.many_places import PLACES_AT_ONCE
from planopt.channel.measurement_covariance import ageing
from planopt.channel.path_loss import regressors
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms, Prediction, combine


def predict_single(posterior: ChannelPosterior, positions_m: NDArray[np.float64]) -> Prediction:
    """Predict as :func:`planopt.channel.kriging.predict` does, in single precision.

    Measured on 50 m by 50 m with xi = 4 dB and beta = 10 m at 1,000 measurements: mean within
    6e-5 dB and deviation within 5e-6 dB at omega = 2 dB, 1e-4 and 3e-5 dB at omega = 0.1 dB. The
    error grows with xi / omega, the condition of the factor.

    Parameters
    ----------
    posterior
        The channel given measurements.
    positions_m
        ``(n, 2)``.

    Raises
    ------
    InputError
        Positions are not ``(n, 2)`` and finite.
    """
    places = require_places(positions_m)
    parameters = posterior.parameters
    origins = posterior.origins
    measured = origins.positions_m
    # About the middle of the places, where single precision has its digits.
    middle = places.mean(axis=0)
    places_single = (places - middle).astype(np.float32)
    measured_single = (measured - middle).astype(np.float32)
    lower = posterior.factor.astype(np.float32)
    # Powers about the path loss in use, so that sums stay small.
    residual = posterior.whitened_values - posterior.whitened_regressors @ posterior.theta
    columns = np.column_stack([residual, posterior.whitened_regressors]).astype(np.float32)
    projected = np.empty((len(places), 3))
    explained = np.empty(len(places))
    rate = np.float32(-1.0 / parameters.decorrelation_m)
    scale = np.full((len(measured), 1), parameters.shadow_std_db**2, dtype=np.float32)
    if origins.time_s is not None:
        scale *= ageing(origins.time_s[:, None], posterior.now_s, parameters).astype(np.float32)
    for start in range(0, len(places), PLACES_AT_ONCE):
        part = slice(start, start + PLACES_AT_ONCE)
        solved = measured_single[:, None, 0] - places_single[None, part, 0]
        across_y = measured_single[:, None, 1] - places_single[None, part, 1]
        solved *= solved
        across_y *= across_y
        solved += across_y
        if origins.blur_m2 is not None:
            solved += origins.blur_m2[:, None].astype(np.float32)
        np.sqrt(solved, out=solved)
        solved *= rate
        np.exp(solved, out=solved)
        solved *= scale
        for row in range(0, len(measured), SOLVE_BLOCK):
            rows = slice(row, row + SOLVE_BLOCK)
            solved[rows] -= lower[rows, :row] @ solved[:row]
            solved[rows] = solve_lower_single(lower[rows, rows], solved[rows])
        projected[part] = solved.T @ columns
        explained[part] = np.einsum("ij,ij->j", solved, solved)
    trend = regressors(places, parameters.station) - projected[:, 1:]
    # a = phi' U^-1 y = phi' U^-1 (y - Gamma theta) + (Gamma' U^-1 phi)' theta.
    data = projected[:, 0] + projected[:, 1:] @ posterior.theta
    latent = np.maximum(parameters.shadow_std_db**2 - explained, 0.0)
    terms = KrigingTerms(data, trend, latent + parameters.multipath_std_db**2)
    return combine(terms, posterior.theta, posterior.theta_covariance)
