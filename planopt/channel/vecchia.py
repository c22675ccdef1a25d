"""Vecchia's approximation of a long log's information, and estimates of receivers' offsets.

Each measurement is conditioned on the nearest of those before it: an inverse factor with few
entries per row (Vecchia, Journal of the Royal Statistical Society B, 1988; Datta et al., Journal of
the American Statistical Association, 2016). Only the products of the whitened columns are stored,
so that one more measurement costs the same whatever their number. Receivers' offsets have columns
of their own, because the nearest measurements need not be by the same receiver. A batch is taken in
blocks from coarse to fine (:mod:`planopt.channel.neighbours`), later measurements one by one.

A measurement by receiver r reads o_r more than receiver 0 would. With Z the indicators of the
receivers and U the covariance of the measurements, which includes s^2 Z Z', the offsets given theta
have mean s^2 Z' U^-1 (y - Gamma theta) and covariance s^2 I - s^4 Z' U^-1 Z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import factor_and_inverse, whiten
from planopt.channel.measurement_covariance import (
    RECEIVER_OFFSET_STD_DB,
    measured_origins,
    own_covariance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.neighbours import (
    BESIDE,
    BLOCK,
    PlaceIndex,
    earlier_windows,
    later_windows,
    place_blocks,
)
from planopt.channel.parameters import ChannelParameters, regressors

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior

EARLIER_NEIGHBOURS = 64
"""Number of earlier measurements that each later one is conditioned on."""


@dataclass(frozen=True, eq=False)
class VecchiaInformation:
    """Sums over all measurements."""

    receivers: NDArray[np.intp]  # (R,) numbers, ascending, without 0
    # (3 + R, 3 + R) C' U0^-1 C of the columns C = [y - Gamma theta_0, Gamma, Z]: theta_0 that of
    # the parameters, Z the receivers' indicators, U0 the covariance without offsets
    products: NDArray[np.float64]

    def path_loss_products(self) -> NDArray[np.float64]:
        """``(3, 3)`` of [y - Gamma theta_0, Gamma], the offsets integrated out (Woodbury)."""
        crossed = self.products[:3, 3:]
        return self.products[:3, :3] - crossed @ self.offset_covariance_db2() @ crossed.T

    def offset_covariance_db2(self) -> NDArray[np.float64]:
        """``(R, R)`` covariance of the offsets given theta, (I / s^2 + Z' U0^-1 Z)^-1."""
        prior = np.eye(len(self.receivers)) / RECEIVER_OFFSET_STD_DB**2
        return np.asarray(np.linalg.inv(self.products[3:, 3:] + prior), dtype=np.float64)


def vecchia_information(
    parameters: ChannelParameters,
    measurements: Measurements,  # n
    values_db: NDArray[np.float64],  # (n,) of their sites
    noise_variance_db2: NDArray[np.float64],  # (n,) of their sites
    before: tuple[VecchiaInformation, PlaceIndex] | None = None,  # Sums over the first of them
) -> VecchiaInformation:
    """Sum over `measurements`, or add those beyond the index of `before`, in their order."""
    places = measurements.positions_m
    if before is None:
        windows = earlier_windows(places, place_blocks(places, BLOCK), BESIDE)
        receivers = np.unique(measurements.receiver)
    else:
        windows = later_windows(places, before[1], EARLIER_NEIGHBOURS)
        new = measurements.receiver[len(before[1].positions_m) :]
        receivers = np.union1d(before[0].receivers, new)
    receivers = receivers[receivers != 0]
    products = np.zeros((3 + len(receivers), 3 + len(receivers)))
    origins = measured_origins(measurements, parameters).without_offsets()
    for window in windows:
        rows = window.rows
        part = origins.at(rows)
        gamma = regressors(part.positions_m, parameters.station)
        centred = values_db[rows] - gamma @ [parameters.k_pl_db, parameters.n_pl]
        indicators = measurements.receiver[rows][:, None] == receivers
        covariance = own_covariance_db2(part, parameters)
        covariance.flat[:: len(rows) + 1] += noise_variance_db2[rows]
        _, inverse = factor_and_inverse(covariance)
        columns = np.column_stack([centred, gamma, indicators])
        whitened = inverse[len(window.beside) :] @ columns
        products += whitened.T @ whitened
    if before is not None:
        kept = 3 + np.searchsorted(receivers, before[0].receivers)
        kept = np.concatenate([np.arange(3), kept])
        products[np.ix_(kept, kept)] += before[0].products
    return VecchiaInformation(receivers, products)


@dataclass(frozen=True)
class ReceiverOffset:
    """The offset of a receiver's readings from those of receiver 0."""

    receiver: int  # Its number
    offset_db: float
    standard_error_db: float  # With the uncertainty of theta


@dataclass(frozen=True, eq=False)
class OffsetsGivenTheta:
    """The offsets of R receivers given all measurements and theta."""

    # (R,) numbers, ascending, without 0; none if every measurement is by receiver 0
    receivers: NDArray[np.intp]
    # (R, 3) s^2 Z' U^-1 [y, Gamma]: the mean is its first column less the others by theta
    means_db: NDArray[np.float64]
    covariance_db2: NDArray[np.float64]  # (R, R) s^2 I - s^4 Z' U^-1 Z

    def indicators(self, receiver: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return Z for measurements by `receiver` (...); ``(..., R)``."""
        return (receiver[..., None] == self.receivers).astype(np.float64)


def offsets_given_theta(posterior: ChannelPosterior) -> OffsetsGivenTheta:
    """Return the offsets from all measurements; O(R kappa^2) with a factor."""
    if posterior.information is not None:
        # s^2 Z' U^-1 = V Z' U0^-1, with V the offsets' covariance.
        covariance = posterior.information.offset_covariance_db2()
        means = covariance @ posterior.information.products[3:, :3]
        theta = [posterior.parameters.k_pl_db, posterior.parameters.n_pl]
        # The products have y - Gamma theta_0 in place of y.
        means[:, 0] += means[:, 1:] @ theta
        return OffsetsGivenTheta(posterior.information.receivers, means, covariance)
    receiver = posterior.measurements.receiver
    receivers = np.unique(receiver[receiver != 0])
    if not len(receivers):
        return OffsetsGivenTheta(receivers, np.zeros((0, 3)), np.zeros((0, 0)))
    prior = RECEIVER_OFFSET_STD_DB**2
    whitened = whiten(posterior.factor, (receiver[:, None] == receivers).astype(np.float64))
    columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
    covariance = prior * np.eye(len(receivers)) - prior**2 * (whitened.T @ whitened)
    return OffsetsGivenTheta(receivers, prior * (whitened.T @ columns), covariance)


def receiver_offsets(posterior: ChannelPosterior) -> tuple[ReceiverOffset, ...]:
    """Return estimated offsets of all receivers except number 0, in ascending order.

    Without measurements by receiver 0 the offsets are known up to a common constant, which the
    prior (mean 0, standard deviation `RECEIVER_OFFSET_STD_DB`) decides; the standard errors
    include that.
    """
    found = offsets_given_theta(posterior)
    trend = found.means_db[:, 1:]
    means = found.means_db[:, 0] - trend @ posterior.theta
    covariance = found.covariance_db2 + trend @ posterior.theta_covariance @ trend.T
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(
        ReceiverOffset(int(receiver), float(mean), float(error))
        for receiver, mean, error in zip(found.receivers, means, errors, strict=True)
    )
