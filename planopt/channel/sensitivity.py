"""Sensitivity of predictions: spatial derivatives, and errors due to wrong parameters.

Derivatives are those of the exact posterior, with the uncertainty of theta. The kernel
exp(-d / beta) has a cusp at every measured position, where an error is raised because there is no
derivative (solvers smooth the cusp). Delta^2(q), the mean squared error of the posterior under
wrong parameters, shows which parameters matter (section II-B and Fig. 1 of [GM11]).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.cholesky import lower_factor, solve_upper, whiten
from planopt.channel.gaussian_sites import MIN_NOISE_VARIANCE_DB2
from planopt.channel.kriging import kriging_terms
from planopt.channel.measurement_covariance import ageing, shadow_covariance_db2
from planopt.channel.parameters import (
    MIN_DISTANCE_M,
    ChannelParameters,
    Station,
    regressors,
    require_places,
)
from planopt.channel.posterior import EXACT_LIMIT, ChannelPosterior
from planopt.errors import InputError

ELEMENTS = 2**17
"""Target number of pairs of a position and a measurement in a block."""


@dataclass(frozen=True)
class PosteriorDerivatives:
    """Predicted power at n positions with spatial derivatives."""

    mean_db: NDArray[np.float64]  # (n,) as in :func:`planopt.channel.kriging.predict`
    deviation_db: NDArray[np.float64]
    mean_gradient: NDArray[np.float64]  # (n, 2) dB/m
    deviation_gradient: NDArray[np.float64]
    mean_hessian: NDArray[np.float64]  # (n, 2, 2) dB/m^2, symmetric
    deviation_hessian: NDArray[np.float64]


def posterior_derivatives(
    posterior: ChannelPosterior, positions_m: ArrayLike
) -> PosteriorDerivatives:
    """Return spatial derivatives of mean and standard deviation up to second order (equation 1.8).

    With r = U^-1 (y - Gamma theta), c = U^-1 phi, A = U^-1 Gamma and b = gamma - A' phi:

        mean = gamma' theta + phi' r
        sigma^2 = xi^2 + omega^2 - phi' c + b' M b
        d(phi' c) = 2 dphi' c,   d^2(phi' c) = 2 dphi' U^-1 dphi + 2 d^2phi' c

    Parameters
    ----------
    posterior
        Channel conditional on measurements; the sites of censored ones are held fixed.
    positions_m
        ``(n, 2)`` positions; path loss is constant within `MIN_DISTANCE_M` of the station.

    Raises
    ------
    InputError
        A position coincides with a measured one, the standard deviation is zero (without multipath,
        within rounding of a measured position), or positions are not ``(n, 2)`` and finite.
    """
    places = require_places(positions_m)
    terms = kriging_terms(posterior, places)
    theta, spread = posterior.theta, posterior.theta_covariance
    lower = posterior.factor
    residual = posterior.whitened_values - posterior.whitened_regressors @ theta
    weights = solve_upper(lower, np.column_stack([residual, posterior.whitened_regressors]))
    mean = terms.data_db + terms.trend @ theta
    variance = terms.variance_db2 + np.einsum("ni,ij,nj->n", terms.trend, spread, terms.trend)
    if (variance <= 0.0).any():
        raise InputError(
            f"the power at position {int(variance.argmin())} (counted from 0) is known exactly: "
            "its deviation has no derivative",
            key="positions_m",
            remedy="move it away from the measured place",
        )
    # Derivatives of the mean and of the variance.
    gradients = np.empty((2, len(places), 2))
    hessians = np.empty((2, len(places), 2, 2))
    block = max(1, ELEMENTS // max(1, len(posterior.measurements)))
    for start in range(0, len(places), block):
        part = slice(start, start + block)
        phi, first, second = _kernel_derivatives(posterior, places[part], start)
        loss_first, loss_second = _path_loss_derivatives(places[part], posterior.parameters.station)
        columns = np.concatenate([phi[..., None], first], axis=2)
        half = whiten(lower, columns.reshape(len(phi), 3 * phi.shape[1])).reshape(columns.shape)
        solved = solve_upper(lower, half[:, :, 0])
        gradients[0, part] = theta[1] * loss_first + np.einsum("kni,k->ni", first, weights[:, 0])
        hessians[0, part] = theta[1] * loss_second + np.einsum("knij,k->nij", second, weights[:, 0])
        trend_first = -np.einsum("kni,kp->npi", first, weights[:, 1:])
        trend_first[:, 1] += loss_first
        trend_second = -np.einsum("knij,kp->npij", second, weights[:, 1:])
        trend_second[:, 1] += loss_second
        pull = terms.trend[part] @ spread
        gradients[1, part] = 2.0 * (
            np.einsum("np,npi->ni", pull, trend_first) - np.einsum("kni,kn->ni", first, solved)
        )
        hessians[1, part] = 2.0 * (
            np.einsum("npi,pq,nqj->nij", trend_first, spread, trend_first)
            + np.einsum("np,npij->nij", pull, trend_second)
            - np.einsum("kni,knj->nij", half[:, :, 1:], half[:, :, 1:])
            - np.einsum("knij,kn->nij", second, solved)
        )
    deviation = np.sqrt(variance)
    deviation_first = gradients[1] / (2.0 * deviation[:, None])
    deviation_second = (
        0.5 * hessians[1] - deviation_first[:, :, None] * deviation_first[:, None, :]
    ) / deviation[:, None, None]
    return PosteriorDerivatives(
        mean, deviation, gradients[0], deviation_first, hessians[0], deviation_second
    )


def _kernel_derivatives(
    posterior: ChannelPosterior, places_m: NDArray[np.float64], first_index: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the kernel phi (kappa, n) with spatial gradient (.., 2) and Hessian (.., 2, 2)."""
    # With u the unit vector from the measurement they are -phi u / beta and phi (u u' / beta^2 - (I
    # - u u') / (beta r)). A position error enlarges r and smooths the cusp.
    beta = posterior.parameters.decorrelation_m
    origins = posterior.origins
    offset = places_m[None] - origins.positions_m[:, None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    if origins.blur_m2 is not None:
        distance = np.sqrt(distance**2 + origins.blur_m2[:, None])
    if (distance == 0.0).any():
        measurement, place = (int(index) for index in np.argwhere(distance == 0.0)[0])
        raise InputError(
            f"position {first_index + place} is where measurement {measurement} was taken "
            "(both counted from 0): the prediction has a cusp there and no derivative",
            key="positions_m",
            remedy="move it by any distance, or differentiate the rounded kernel",
        )
    phi = posterior.parameters.shadow_std_db**2 * np.exp(-distance / beta)
    if origins.time_s is not None:
        phi *= ageing(origins.time_s[:, None], posterior.now_s, posterior.parameters)
    unit = offset / distance[..., None]
    along = unit[..., :, None] * unit[..., None, :]
    first = (-phi / beta)[..., None] * unit
    second = (phi / beta**2)[..., None, None] * along
    second -= (phi / (beta * distance))[..., None, None] * (np.eye(2) - along)
    return phi, first, second


def _path_loss_derivatives(
    places_m: NDArray[np.float64], station: Station
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return gradient (n, 2) and Hessian (n, 2, 2) of -10 log10 d; zero at the minimum distance."""
    offset = places_m - np.asarray(station.position_m)
    square = (offset**2).sum(axis=1) + station.height_m**2
    scale = np.where(
        square > MIN_DISTANCE_M**2,
        -10.0 / np.log(10.0) / np.maximum(square, MIN_DISTANCE_M**2),
        0.0,
    )
    along = offset[:, :, None] * offset[:, None, :]
    along /= np.maximum(square, MIN_DISTANCE_M**2)[:, None, None]
    return scale[:, None] * offset, scale[:, None, None] * (np.eye(2) - 2.0 * along)


PERTURBED = ("k_pl_db", "n_pl", "shadow_variance_db2", "decorrelation_m", "multipath_std_db")
"""Names of the parameters perturbed in Fig. 1 of [GM11]: K_PL, n_PL, xi^2, beta and omega."""


def mean_squared_error_db2(
    true: ChannelParameters,
    assumed: ChannelParameters,
    measured_m: ArrayLike,
    positions_m: ArrayLike,
) -> NDArray[np.float64]:
    """Return the exact Delta^2(q) for any errors in the parameters (equation 1.16).

    With w = U_est^-1 phi_est the weights of equation 1.6 and delta theta = theta - theta_est,

        Delta^2 = xi^2 + omega^2 - 2 w' phi + w' U w + ((gamma - Gamma' w)' delta theta)^2,

    as in [GM11]. The last term is the squared bias. It is computed from both path losses, so the
    station may be wrong too. The posterior assumes that theta is known.

    Parameters
    ----------
    true
        True parameters of the channel.
    assumed
        Parameters that the posterior assumes.
    measured_m
        ``(kappa, 2)`` positions of uncensored measurements; may be empty.
    positions_m
        ``(n, 2)`` positions of the predictions.

    Returns
    -------
    NDArray
        ``(n,)`` mean squared errors in dB^2, multipath included.

    Raises
    ------
    InputError
        Positions are not ``(n, 2)`` and finite, or there are more than `EXACT_LIMIT` measured ones.
    """
    measured = require_places(measured_m, at_least=0)
    if len(measured) > EXACT_LIMIT:
        raise InputError(
            f"this needs matrices of all measurements, and {len(measured):,} are more than the "
            f"{EXACT_LIMIT:,} that planopt factorises",
            key="measured_m",
            remedy="give those near the places in question",
        )
    places = require_places(positions_m)
    count = len(measured)
    total = shadow_covariance_db2(measured, measured, true)
    total[np.diag_indices(count)] += true.multipath_std_db**2
    # The posterior as planopt computes it, with its minimum nugget.
    believed = shadow_covariance_db2(measured, measured, assumed)
    believed[np.diag_indices(count)] += max(assumed.multipath_std_db**2, MIN_NOISE_VARIANCE_DB2)
    precision = _inverse(believed)
    # w' U w = phi_est' B phi_est needs one product per block of positions.
    spread = precision @ total @ precision
    offset = _path_loss_db(true, measured) - _path_loss_db(assumed, measured)
    error = np.empty(len(places))
    block = max(1, ELEMENTS // max(1, count))
    for start in range(0, len(places), block):
        part = slice(start, start + block)
        across = shadow_covariance_db2(places[part], measured, true)
        across_assumed = shadow_covariance_db2(places[part], measured, assumed)
        weights = across_assumed @ precision
        bias = _path_loss_db(true, places[part]) - _path_loss_db(assumed, places[part])
        bias -= weights @ offset
        error[part] = (
            np.einsum("nk,nk->n", across_assumed @ spread, across_assumed)
            - 2.0 * np.einsum("nk,nk->n", weights, across)
            + bias**2
        )
    return error + true.shadow_std_db**2 + true.multipath_std_db**2


def perturbed(parameters: ChannelParameters, name: str, relative_error: float) -> ChannelParameters:
    """Return parameters with one of `PERTURBED` multiplied by 1 + `relative_error`."""
    if not (math.isfinite(relative_error) and relative_error > -1.0):
        raise InputError(
            f"a relative error of {relative_error!r} cannot be applied",
            key="relative_error",
            remedy="use a share above -1",
        )
    factor = 1.0 + relative_error
    if name == "shadow_variance_db2":
        return replace(parameters, shadow_std_db=parameters.shadow_std_db * math.sqrt(factor))
    if name not in PERTURBED:
        raise InputError(
            f"{name!r} is not a parameter that can be perturbed",
            key="name",
            remedy=f"use one of {', '.join(PERTURBED)}",
        )
    return replace(parameters, **{name: getattr(parameters, name) * factor})


def sensitivity_curves(
    true: ChannelParameters,
    measured_m: NDArray[np.float64],
    positions_m: NDArray[np.float64],
    relative_errors: Sequence[float],
) -> dict[str, NDArray[np.float64]]:
    """Return the mean Delta^2 as a function of the error in each parameter (Fig. 1 of [GM11]).

    Parameters
    ----------
    true
        True parameters of the channel.
    measured_m
        ``(kappa, 2)`` positions of measurements.
    positions_m
        ``(n, 2)`` positions to average over, which represent the workspace.
    relative_errors
        ``(k,)`` relative errors, 0.1 for 10 %.

    Returns
    -------
    dict
        ``(k,)`` averages in dB^2 for each of `PERTURBED`.
    """
    return {
        name: np.array(
            [
                mean_squared_error_db2(
                    true, perturbed(true, name, error), measured_m, positions_m
                ).mean()
                for error in relative_errors
            ]
        )
        for name in PERTURBED
    }


def _inverse(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a covariance (kappa, kappa); kappa may be 0."""
    if not len(covariance):
        return covariance
    half = whiten(lower_factor(covariance), np.eye(len(covariance)))
    return half.T @ half


def _path_loss_db(
    parameters: ChannelParameters, places_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean power gamma' theta at `places_m` (n, 2)."""
    theta = np.array([parameters.k_pl_db, parameters.n_pl])
    return regressors(places_m, parameters.station) @ theta
