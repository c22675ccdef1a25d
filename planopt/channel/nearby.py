"""Prediction from the measurements near a group of places, at a cost that does not grow with all.

A group shares one set of measurements, the union of every place's nearest, and so one factor. Each
place is conditioned on at least its own nearest ones: a true posterior of less data, whose variance
is never below the full one's but for the uncertainty of theta, which is the full data's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import lower_factor, solve_lower
from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.neighbours import nearest
from planopt.channel.path_loss import regressors
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms, Prediction, combine

GROUP = 16
"""Consecutive places that share measurements: a path's places, a row of a grid."""


def predict_nearby(
    posterior: ChannelPosterior, positions_m: NDArray[np.float64], count: int
) -> Prediction:
    """Mean and deviation at `positions_m` (n, 2) from the `count` nearest measurements and more.

    Measured against the full posterior at 5,000 measurements of the Munich channel: at most 2e-5 dB
    off at 512, 0.004 dB at 128.
    """
    mean, deviation = np.empty(len(positions_m)), np.empty(len(positions_m))
    for start in range(0, len(positions_m), GROUP):
        part = slice(start, start + GROUP)
        prediction = _of_group(posterior, positions_m[part], count)
        mean[part], deviation[part] = prediction.mean_db, prediction.deviation_db
    return Prediction(mean, deviation)


def _of_group(posterior: ChannelPosterior, places_m: NDArray[np.float64], count: int) -> Prediction:
    """Lemma 2 from the union of the places' nearest measurements."""
    parameters = posterior.parameters
    used = np.unique(nearest(posterior.measurements.positions_m, places_m, count)[0])
    at = posterior.measurements.positions_m[used]
    covariance = shadow_covariance_db2(at, at, parameters)
    covariance[np.diag_indices_from(covariance)] += posterior.noise_variance_db2[used]
    columns = np.column_stack(
        [
            posterior.values_db[used],
            regressors(at, parameters.station),
            shadow_covariance_db2(at, places_m, parameters),
        ]
    )
    whitened = solve_lower(lower_factor(covariance), columns)
    values, trend, across = whitened[:, 0], whitened[:, 1:3], whitened[:, 3:]
    latent = parameters.shadow_std_db**2 - np.einsum("ij,ij->j", across, across)
    terms = KrigingTerms(
        values @ across,
        regressors(places_m, parameters.station) - across.T @ trend,
        np.maximum(latent, 0.0) + parameters.multipath_std_db**2,
    )
    return combine(terms, posterior.theta, posterior.theta_covariance)
