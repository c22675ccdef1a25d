"""Errors of predictions due to wrong parameters (section II-B and Fig. 1 of [GM11])."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.cholesky import lower_factor, whiten
from planopt.channel.gaussian_sites import MIN_NOISE_VARIANCE_DB2
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.parameters import (
    ChannelParameters,
    regressors,
    require_places,
)
from planopt.channel.posterior import EXACT_LIMIT
from planopt.errors import InputError

ELEMENTS = 2**17
"""Target number of pairs of a position and a measurement in a block."""


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
