"""Offsets of several robots' receivers, estimated with the channel.

A measurement by receiver r reads o_r more than receiver 0 would. With Z the indicators of the
receivers and U the covariance of the measurements, the offsets' variance s^2 Z Z' included, the
offsets given theta have mean s^2 Z' U^-1 (y - Gamma theta) and covariance s^2 I - s^4 Z' U^-1 Z:
the best linear unbiased prediction once theta is the generalised least squares one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.channel.factor import whiten
from planopt.channel.measurement_covariance import RECEIVER_OFFSET_STD_DB
from planopt.channel.nearest.vecchia import VecchiaInformation

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior


@dataclass(frozen=True)
class ReceiverOffset:
    """The offset of a receiver's readings from those of receiver 0."""

    receiver: int  # Its number
    offset_db: float  # Estimate and its standard error, the uncertainty of theta counted
    standard_error_db: float


@dataclass(frozen=True, eq=False)
class OffsetsGivenTheta:
    """The offsets of R receivers as they follow from all measurements once theta is known."""

    # (R,) numbers, ascending, without 0; none where every measurement is by receiver 0
    receivers: NDArray[np.intp]
    # (R, 3) s^2 Z' U^-1 [y, Gamma]: the mean is its first column less the others by theta
    means_db: NDArray[np.float64]
    covariance_db2: NDArray[np.float64]  # (R, R) s^2 I - s^4 Z' U^-1 Z

    def indicators(self, receiver: NDArray[np.intp]) -> NDArray[np.float64]:
        """Z for measurements by `receiver` (...); ``(..., R)``."""
        return (receiver[..., None] == self.receivers).astype(np.float64)

    def variance_db2(self, projected: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the variance of the offsets at places, for phi' U0^-1 Z (..., R); ``(...)``.

        U0 is the covariance without offsets.
        """
        return ((projected @ self.covariance_db2) * projected).sum(axis=-1)


def offsets_given_theta(posterior: ChannelPosterior) -> OffsetsGivenTheta:
    """The offsets from all measurements; O(R kappa^2) where `posterior` has a factor."""
    if posterior.information is not None:
        return _from_information(posterior, posterior.information)
    given = posterior.measurements.receiver
    receivers = np.unique(given[given != 0])
    if not len(receivers):
        return OffsetsGivenTheta(receivers, np.zeros((0, 3)), np.zeros((0, 0)))
    prior = RECEIVER_OFFSET_STD_DB**2
    whitened = whiten(posterior.factor, (given[:, None] == receivers).astype(np.float64))
    columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
    covariance = prior * np.eye(len(receivers)) - prior**2 * (whitened.T @ whitened)
    return OffsetsGivenTheta(receivers, prior * (whitened.T @ columns), covariance)


def _from_information(
    posterior: ChannelPosterior, information: VecchiaInformation
) -> OffsetsGivenTheta:
    """The same without a factor: s^2 Z' U^-1 = V Z' U0^-1, with V the offsets' covariance."""
    covariance = information.offset_covariance_db2()
    means = covariance @ information.products[3:, :3]
    parameters = posterior.parameters
    # Of y itself, from y about theta_0.
    means[:, 0] += means[:, 1:] @ [parameters.k_pl_db, parameters.n_pl]
    return OffsetsGivenTheta(information.receivers, means, covariance)


def receiver_offsets(posterior: ChannelPosterior) -> tuple[ReceiverOffset, ...]:
    """Estimated offsets of all receivers but number 0, in ascending order.

    Where no measurement is by receiver 0 the offsets are known but for a common constant, which
    the prior (mean 0, deviation `RECEIVER_OFFSET_STD_DB`) then decides; the standard errors say so.
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
