"""What a posterior keeps of its measurements: rows of a factor, or sums over neighbours."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.least_squares_theta import least_squares_theta
from planopt.channel.factor import append_rows, with_room
from planopt.channel.mean_model import regressors
from planopt.channel.nearest.neighbour_information import (
    extended_information,
    neighbour_information,
)
from planopt.channel.theta_estimate import theta_estimate

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior


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
