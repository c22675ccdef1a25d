"""Predict measurements from all others, in closed form from the factor that is there.

With U the measurements' covariance, e_i the i-th unit vector, w = L^-1 e_i and theta by generalised
least squares with covariance M, column i of Q = U^-1 - U^-1 Gamma M Gamma' U^-1 follows from w. The
prediction of measurement i from all others is off by [Q y]_i / Q_ii, with variance 1 / Q_ii, its
own noise included (Dubrule, "Cross validation of kriging in a unique neighborhood", 1983). Where
there is no factor, the nearest others stand for all, with theta of all measurements.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.vecchia import EARLIER_NEIGHBOURS
from planopt.channel.factor import whiten
from planopt.channel.nearest.neighbour_regression import regress_on_neighbours
from planopt.channel.path_loss import regressors
from planopt.channel.prediction import KrigingTerms, Prediction, combine

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior


def leave_one_out(posterior: ChannelPosterior, rows: NDArray[np.intp]) -> Prediction:
    """Predict the powers of some measurements from all measurements but the one in question.

    The parameters xi, beta and omega stay those fitted to all, and a Gaussian site that stands for
    a censored measurement stays as it is.

    Parameters
    ----------
    posterior
        At least two measurements; theta known or estimated by generalised least squares.
    rows
        ``(k,)`` which of them.

    Returns
    -------
    Prediction
        ``(k,)`` of the power that would be measured, as
        :meth:`planopt.channel.posterior.ChannelPosterior.predict` gives it.
    """
    if not posterior.has_factor:
        return _from_nearest(posterior, rows)
    unit = np.zeros((len(posterior.measurements), len(rows)))
    unit[rows, np.arange(len(rows))] = 1.0
    whitened = whiten(posterior.factor, unit)
    gamma = posterior.whitened_regressors
    across = gamma.T @ whitened
    residual = posterior.whitened_values - gamma @ posterior.theta
    precision = np.einsum("ij,ij->j", whitened, whitened)
    precision -= np.einsum("ij,ik,kj->j", across, posterior.theta_covariance, across)
    mean = posterior.values_db[rows] - (residual @ whitened) / precision
    latent = np.maximum(1.0 / precision - posterior.noise_variance_db2[rows], 0.0)
    return Prediction(mean, np.sqrt(latent + posterior.parameters.multipath_std_db**2))


def _from_nearest(posterior: ChannelPosterior, rows: NDArray[np.intp]) -> Prediction:
    """Predict from the nearest others."""
    parameters, places_m = posterior.parameters, posterior.measurements.positions_m
    found, _ = posterior.index.nearest(places_m[rows], EARLIER_NEIGHBOURS + 1)
    # Itself is among them, or as many others at the very same place are.
    itself = found == rows[:, None]
    itself[~itself.any(axis=1), -1] = True
    near = found[~itself].reshape(len(rows), -1)
    regression = regress_on_neighbours(
        parameters,
        posterior.origins.at(rows[:, None]),
        posterior.origins.at(near),
        posterior.noise_variance_db2[near],
        np.zeros(near.shape, dtype=bool),
    )
    beside = regressors(places_m[near], parameters.station)
    data = np.einsum("km,km->k", regression.weights, posterior.values_db[near])
    trend = regressors(places_m[rows], parameters.station)
    trend = trend - np.einsum("km,kmi->ki", regression.weights, beside)
    variance = regression.variance_db2 + parameters.multipath_std_db**2
    return combine(KrigingTerms(data, trend, variance), posterior.theta, posterior.theta_covariance)
