"""Vecchia's approximation: information of any number of measurements without a factor of all.

Each measurement is conditioned on the nearest of those before it: an inverse factor with few
entries a row (Vecchia, Journal of the Royal Statistical Society B, 1988; Datta et al., Journal
of the American Statistical Association, 2016). Only the products of the whitened columns are kept,
so that one more measurement costs the same whatever their number. Receivers' offsets are columns of
their own, because the nearest measurements need not be by the same receiver.

A batch is taken in blocks from coarse to fine (:mod:`planopt.channel.nearest.windows`), so that the
products depend on where measurements are, not on the order of their rows. Those that come later are
taken one by one in their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import factor_and_inverse
from planopt.channel.measurement_covariance import (
    RECEIVER_OFFSET_STD_DB,
    measured_origins,
    own_covariance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.place_index import PlaceIndex
from planopt.channel.nearest.windows import (
    BESIDE,
    BLOCK,
    Window,
    earlier_windows,
    later_windows,
    place_blocks,
)
from planopt.channel.parameters import ChannelParameters, regressors

EARLIER_NEIGHBOURS = 64
"""Number of earlier measurements that each one added later is conditioned on."""


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
        information = self.products[3:, 3:] + np.eye(len(self.receivers)) / (
            RECEIVER_OFFSET_STD_DB**2
        )
        return np.asarray(np.linalg.inv(information), dtype=np.float64)


def vecchia_information(
    parameters: ChannelParameters,
    measurements: Measurements,  # n
    values_db: NDArray[np.float64],  # (n,) of their sites
    noise_variance_db2: NDArray[np.float64],  # (n,) of their sites
    before: tuple[VecchiaInformation, PlaceIndex] | None = None,  # Sums over the first of them
) -> VecchiaInformation:
    """Sum over `measurements`, or add those that the index of `before` lacks, in their order."""
    places = measurements.positions_m
    if before is None:
        windows = earlier_windows(places, place_blocks(places, BLOCK), BESIDE)
        receivers = np.unique(measurements.receiver)
    else:
        windows = later_windows(places, before[1], EARLIER_NEIGHBOURS)
        new = measurements.receiver[len(before[1].positions_m) :]
        receivers = np.union1d(before[0].receivers, new)
    receivers = receivers[receivers != 0]
    products = _products(
        parameters, measurements, values_db, noise_variance_db2, receivers, windows
    )
    if before is not None:
        kept = 3 + np.searchsorted(receivers, before[0].receivers)
        kept = np.concatenate([np.arange(3), kept])
        products[np.ix_(kept, kept)] += before[0].products
    return VecchiaInformation(receivers, products)


def _products(
    parameters: ChannelParameters,
    measurements: Measurements,
    values_db: NDArray[np.float64],
    noise_variance_db2: NDArray[np.float64],
    receivers: NDArray[np.intp],
    windows: Sequence[Window],
) -> NDArray[np.float64]:
    """Sum the products of whitened columns over windows, ``(3 + R, 3 + R)``."""
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
    return products
