"""What a posterior keeps of its measurements, and the path loss that follows from it.

Rows of a factor, or sums over neighbours. Path loss is found by generalised least squares from
products of whitened columns, or by ordinary least squares with the error that it has under the
model: the latter weighs every measurement alike, which is not best where shadowing is correlated,
but does not depend on xi, beta and omega.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.identifiability import MIN_REGRESSOR_SPREAD_DB
from planopt.channel.estimation.least_squares import receiver_columns
from planopt.channel.factor import append_rows, with_room
from planopt.channel.mean_model import regressors
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.neighbour_information import (
    extended_information,
    neighbour_information,
)
from planopt.channel.parameters import ChannelParameters, Station

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior


def least_squares_theta(
    measurements: Measurements,
    values_db: NDArray[np.float64],
    lower: NDArray[np.float64],
    station: Station,
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Theta and its error covariance (G'G)^-1 G'UG (G'G)^-1; None where it is not identified.

    Censored measurements are left out, since a limit has no residual. Offsets of receivers are
    estimated along with theta.

    Parameters
    ----------
    measurements, values_db
        n of them, and ``(n,)`` their powers.
    lower
        ``(n, n)`` Cholesky factor of U.
    station
        The fixed station.
    """
    exact = ~measurements.censored
    known = measurements.take(exact)
    gamma = regressors(known.positions_m, station)
    if not len(known) or float(np.ptp(gamma[:, 1])) < MIN_REGRESSOR_SPREAD_DB:
        return None
    columns = np.column_stack([gamma, receiver_columns(known)])
    inverse = np.linalg.pinv(columns)[: gamma.shape[1]]
    half = inverse @ lower[exact]
    return inverse @ values_db[exact], half @ half.T


WEAK_THETA_DEVIATION = (20.0, 1.0)
"""Prior deviation of K_PL (dB) and n_PL, used only where the measurements do not identify theta."""

MAX_INFORMATION_CONDITION = 1e10
"""Theta counts as identified while the condition number of its information, in units of
`WEAK_THETA_DEVIATION`, is below this."""


def theta_estimate(
    parameters: ChannelParameters, products: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimate theta and its covariance M (equation 1.7).

    Parameters
    ----------
    parameters
        Its theta, theta_0, is the centre of the weak prior.
    products
        ``(3, 3)`` C' U^-1 C of the columns C = [y - Gamma theta_0, Gamma]: about theta_0, where
        the digits are.
    """
    # In units of the weak prior.
    unit = np.array(WEAK_THETA_DEVIATION)
    information = unit[:, None] * products[1:, 1:] * unit
    spread = np.linalg.eigvalsh(information)
    if spread[0] * MAX_INFORMATION_CONDITION <= spread[1]:
        information += np.eye(2)
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    moved = unit * (covariance @ (unit * products[1:, 0]))
    theta = np.array([parameters.k_pl_db, parameters.n_pl]) + moved
    return theta, unit[:, None] * covariance * unit


def with_rows(grown: ChannelPosterior, before: ChannelPosterior) -> ChannelPosterior:
    """Add rows to the factor and to the whitened columns, and estimate theta.

    Parameters
    ----------
    grown
        All measurements, not yet accounted for.
    before
        The posterior of the first of them.
    """
    parameters, old = grown.parameters, len(before.measurements)
    new = slice(old, None)
    columns = np.empty((len(grown.measurements), 3))
    columns[:old, 0], columns[:old, 1:] = before.whitened_values, before.whitened_regressors
    columns[new, 0] = grown.values_db[new]
    columns[new, 1:] = regressors(grown.measurements.positions_m[new], parameters.station)
    buffer = with_room(before.buffer, old, len(columns))
    append_rows(buffer, parameters, grown.origins, grown.noise_variance_db2, columns)
    about = columns.copy()
    about[:, 0] -= columns[:, 1:] @ [parameters.k_pl_db, parameters.n_pl]
    conditioned = replace(
        grown,
        whitened_values=np.ascontiguousarray(columns[:, 0]),
        whitened_regressors=np.ascontiguousarray(columns[:, 1:]),
        buffer=buffer,
    )
    return _with_theta(conditioned, about.T @ about)


def without_factor(grown: ChannelPosterior, before: ChannelPosterior) -> ChannelPosterior:
    """Count measurements by their neighbours, all of them where there was a factor.

    `grown` and `before` as for :func:`with_rows`.
    """
    given = (grown.parameters, grown.measurements, grown.values_db, grown.noise_variance_db2)
    information = (
        neighbour_information(*given)
        if before.information is None
        else extended_information(before.information, before.index, *given)
    )
    conditioned = replace(
        grown,
        whitened_values=np.zeros(0),
        whitened_regressors=np.zeros((0, 2)),
        buffer=None,
        information=information,
    )
    return _with_theta(conditioned, information.path_loss_products())


def _with_theta(posterior: ChannelPosterior, products: NDArray[np.float64]) -> ChannelPosterior:
    """Estimate theta by its rule; `products` as for `theta_estimate`."""
    if posterior.theta_known:
        return posterior
    theta, covariance = theta_estimate(posterior.parameters, products)
    if posterior.theta_rule == "least_squares":
        found = least_squares_theta(
            posterior.measurements,
            posterior.values_db,
            posterior.factor,
            posterior.parameters.station,
        )
        theta, covariance = found or (theta, covariance)
    return replace(posterior, theta=theta, theta_covariance=covariance)
