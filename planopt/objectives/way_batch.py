"""Predictions along many ways at once, from one set of measurements near them all.

The kernel in single precision: for choosing among ways, where its cost counts most.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kernel import decayed_db2, shadow_covariance_db2
from planopt.channel.mean_model import regressors
from planopt.channel.parameters import ChannelParameters
from planopt.channel.prediction import KrigingTerms, Prediction, combine
from planopt.objectives.local_channel import LocalChannel, LocalGrid


def single_kernel(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    parameters: ChannelParameters,
    blur_m2: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distances of `a` (n, 2) from `b` (m, 2) and covariances of shadowing; both ``(n, m)``.

    Coordinates near 3e6 keep their digits: what is rounded are offsets from the middle of `a`.
    `blur_m2` (m,) is added to the squares.
    """
    middle = a.mean(axis=0)
    from_m, to_m = (a - middle).astype(np.float32), (b - middle).astype(np.float32)
    distance = from_m[:, :1] - to_m[:, 0]
    distance *= distance
    dy = from_m[:, 1:] - to_m[:, 1]
    dy *= dy
    distance += dy
    if blur_m2 is not None:
        distance += blur_m2.astype(np.float32)
    np.sqrt(distance, out=distance)
    return distance, decayed_db2(distance.copy(), parameters)


NUGGET_SHARE = 1e-4
"""Least variance of multipath as a share of the shadowing's: without any, a place that is measured
twice would make the covariance singular."""


class WayBatch:
    """S and B of equation 1.11 for every path.

    Parameters
    ----------
    channel, precision
        The measurements, and their U_mm^-1 in single precision.
    ways_m
        ``(c, N, 2)``.
    grid
        Where a map is wanted, for its average alone.

    Attributes
    ----------
    ways_m
        ``(c, N, 2)``.
    distance_m, phi
        ``(c N, m)`` of every place from the measurements, and the covariance with them, both in
        single precision; distances not below the rounding of the kernel's cusp.
    solved
        ``(c, N, m)`` phi' U_mm^-1.
    covariance, trend
        ``(c, N, N)`` S as if theta were known, ``(c, N, 2)`` B.
    """

    def __init__(
        self,
        channel: LocalChannel,
        precision: NDArray[np.float32],
        ways_m: NDArray[np.float64],
        grid: LocalGrid | None = None,
    ) -> None:
        self.channel, self.ways_m, self._grid = channel, ways_m, grid
        parameters = channel.parameters
        places = ways_m.reshape(-1, 2)
        self.shape: tuple[int, int] = (len(ways_m), len(places) // max(len(ways_m), 1))
        self.distance_m, self.phi = single_kernel(
            places, channel.positions_m, parameters, channel.blur_m2
        )
        self.solved = (self.phi @ precision).reshape(*self.shape, -1)
        by_way = self.phi.reshape(*self.shape, -1)
        self.covariance = shadow_covariance_db2(ways_m, ways_m, parameters)
        self.covariance -= self.solved @ by_way.transpose(0, 2, 1)
        own = np.arange(self.shape[1])
        least = NUGGET_SHARE * parameters.shadow_std_db**2
        nugget = max(parameters.multipath_std_db**2, least)
        self.covariance[:, own, own] += nugget
        # Summed in double precision: theta's covariance may be large.
        projected = self.phi @ np.column_stack([channel.weights, channel.trend])
        self._data_db = projected[:, 0]
        trend = regressors(places, parameters.station) - projected[:, 1:]
        self.trend = trend.reshape(*self.shape, 2)

    @cached_property
    def universal(self) -> NDArray[np.float64]:
        """S + B M B', ``(c, N, N)``."""
        pulled = self.trend @ self.channel.theta_covariance
        return self.covariance + pulled @ self.trend.transpose(0, 2, 1)

    @property
    def required_grid(self) -> LocalGrid:
        """Where a map is wanted."""
        if self._grid is None:
            raise AssertionError("the spatial average needs a grid")
        return self._grid

    @cached_property
    def across(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Distances of all places from the grid's ``(c N, g)``, the kernel, and c(g) weighted.

        The last is ``(c, N, g)``, c of equation 4.6 with theta's uncertainty, times the square
        root of the weight of g.
        """
        channel, grid = self.channel, self.required_grid
        distance, kernel = single_kernel(
            self.ways_m.reshape(-1, 2), grid.positions_m, channel.parameters
        )
        across = kernel.copy()
        across -= self.phi @ grid.solved.astype(np.float32)
        pulled = (channel.theta_covariance @ grid.trend.T).astype(np.float32)
        across += self.trend.reshape(-1, 2).astype(np.float32) @ pulled
        across *= grid.root_weight.astype(np.float32)
        return distance, kernel, across.reshape(*self.shape, -1)

    @cached_property
    def power(self) -> Prediction:
        """Prediction at every place, those of a way together; ``(c N,)``."""
        channel = self.channel
        own = np.arange(self.shape[1])
        terms = KrigingTerms(
            self._data_db, self.trend.reshape(-1, 2), self.covariance[:, own, own].ravel()
        )
        return combine(terms, channel.theta, channel.theta_covariance)
