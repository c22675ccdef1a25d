"""Information of any number of measurements on path loss and on receivers' offsets.

Of the whitened columns only their products are kept, so that one more measurement costs the same
whatever there are (:mod:`planopt.channel.estimation.vecchia`). Offsets are columns of their own
here: the nearest of a measurement need not be by its receiver.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.vecchia import (
    EARLIER_NEIGHBOURS,
    added_products,
    whitened_products,
)
from planopt.channel.measurement_covariance import RECEIVER_OFFSET_STD_DB, measured_origins
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.place_index import PlaceIndex
from planopt.channel.parameters import ChannelParameters, regressors


@dataclass(frozen=True, eq=False)
class NeighbourInformation:
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


def neighbour_information(
    parameters: ChannelParameters,
    measurements: Measurements,
    values_db: NDArray[np.float64],
    noise_variance_db2: NDArray[np.float64],
) -> NeighbourInformation:
    """Sum over `measurements` (n), whose values and noise (n,) are those of their sites."""
    numbers = measurements.receiver
    receivers = np.unique(numbers[numbers != 0])
    columns = _columns(parameters, measurements, values_db, receivers)
    origins = measured_origins(measurements, parameters).without_offsets()
    return NeighbourInformation(
        receivers, whitened_products(parameters, origins, noise_variance_db2, columns)
    )


def extended_information(
    before: NeighbourInformation,
    index: PlaceIndex,
    parameters: ChannelParameters,
    measurements: Measurements,
    values_db: NDArray[np.float64],
    noise_variance_db2: NDArray[np.float64],
) -> NeighbourInformation:
    """Add the measurements that are not in `index` to the sums `before`, in the order given.

    The others are as for :func:`neighbour_information`, all n of them.
    """
    old = len(index.positions_m)
    near, _ = index.nearest(measurements.positions_m[old:], EARLIER_NEIGHBOURS)
    near = np.unique(near)
    used = np.concatenate([near, np.arange(old, len(measurements))])
    part = measurements.take(used)
    new = part.receiver[len(near) :]
    receivers = np.union1d(before.receivers, new[new != 0])
    added = added_products(
        parameters,
        measured_origins(part, parameters).without_offsets(),
        noise_variance_db2[used],
        _columns(parameters, part, values_db[used], receivers),
        len(near),
    )
    kept = np.concatenate([np.arange(3), 3 + np.searchsorted(receivers, before.receivers)])
    added[np.ix_(kept, kept)] += before.products
    return NeighbourInformation(receivers, added)


def _columns(
    parameters: ChannelParameters,
    measurements: Measurements,
    values_db: NDArray[np.float64],
    receivers: NDArray[np.intp],
) -> NDArray[np.float64]:
    """C, ``(n, 3 + R)``."""
    gamma = regressors(measurements.positions_m, parameters.station)
    centred = values_db - gamma @ [parameters.k_pl_db, parameters.n_pl]
    indicators = measurements.receiver[:, None] == receivers
    return np.column_stack([centred, gamma, indicators.astype(np.float64)])
