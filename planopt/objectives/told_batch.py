"""Predictions along many ways at once, what measurements on them tell, and slopes by place.

The kernel between places and measurements is in single precision: this is for choosing among ways,
where its cost counts most. A place of gate g counts as in
:mod:`planopt.objectives.batch_derivatives`: 1 where it brings a measurement, 0 where it brings
none, and between where ways climb, so that slopes show the way out.

Whatever a term does with S and B, its derivatives by the places follow from those by S, by B and by
the covariances with the measurements, at the cost of one more valuation for all ways together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurement_covariance import decayed_db2, shadow_covariance_db2
from planopt.channel.nearest.local_channel import LocalChannel, LocalGrid
from planopt.channel.parameters import ChannelParameters, regressors
from planopt.channel.prediction import KrigingTerms, Prediction, combine
from planopt.objectives.batch_derivatives import blind_variance_db2
from planopt.objectives.measuring import Gates
from planopt.objectives.rounded_kernel import CUSP_ROUNDING, rounded_log_distance

Real = TypeVar("Real", np.float32, np.float64)

TINY_M = 1e-9
"""Places nearer than this have no direction from each other."""


@dataclass(frozen=True, eq=False)
class Pull:
    """Derivatives of one number of each way by the numbers that it is made of; None where zero."""

    by_place: NDArray[np.float64] | None = None  # (c, N, 2) by the places themselves, all else held
    by_covariance: NDArray[np.float64] | None = None  # (c, N, N) by S, symmetric
    by_trend: NDArray[np.float64] | None = None  # (c, N, 2) by B
    # (c, N, m) by the covariances with the measurements, S and B held
    by_phi: NDArray[np.float32] | None = None
    by_gate: NDArray[np.float64] | None = None  # (c, N) by the gates of the places

    def plus(self, other: Pull, weight: float) -> Pull:
        """`weight` times the other added."""
        return Pull(
            _sum(self.by_place, other.by_place, weight),
            _sum(self.by_covariance, other.by_covariance, weight),
            _sum(self.by_trend, other.by_trend, weight),
            _sum(self.by_phi, other.by_phi, weight),
            _sum(self.by_gate, other.by_gate, weight),
        )


def _sum(a: NDArray[Real] | None, b: NDArray[Real] | None, weight: float) -> NDArray[Real] | None:
    """``a + weight b``; None counts as nothing."""
    if b is None:
        return a
    found = b.copy()
    found *= weight
    if a is not None:
        found += a
    return found


def pull_of_power(
    batch: WayBatch, by_mean: NDArray[np.float64], by_deviation: NDArray[np.float64]
) -> Pull:
    """Return the pull by mean and deviation of the power at every place, both ``(c, N)``."""
    channel, own = batch.channel, np.arange(batch.shape[1])
    deviation = batch.power.deviation_db.reshape(batch.shape)
    by_variance = np.zeros((*batch.shape, batch.shape[1]))
    by_variance[:, own, own] = 0.5 * by_deviation / deviation
    return Pull(
        by_covariance=by_variance,
        by_trend=trend_of_universal(batch.trend, channel, by_variance)
        + by_mean[:, :, None] * channel.theta,
        by_phi=by_mean.astype(np.float32)[:, :, None] * channel.weights.astype(np.float32),
    )


def trend_of_universal(
    trend: NDArray[np.float64], channel: LocalChannel, by_universal: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the pull by B = `trend` (c, N, 2), from derivatives by S + B M B' (c, N, N)."""
    return 2.0 * (by_universal @ (trend @ channel.theta_covariance))


def slopes_of(batch: WayBatch, pull: Pull, gates: Gates | None = None) -> NDArray[np.float64]:
    """The derivatives by the places, ``(c, N, 2)``; `gates` are what `pull.by_gate` is by."""
    channel = batch.channel
    found = np.zeros((*batch.shape, 2))
    by_phi = np.zeros_like(batch.solved)
    if pull.by_place is not None:
        found += pull.by_place
    if pull.by_gate is not None and gates is not None:
        found += gates.pulled(pull.by_gate)
    if pull.by_phi is not None:
        by_phi += pull.by_phi
    if pull.by_covariance is not None:
        found += _between(batch, pull.by_covariance)
        by_phi += (-2.0 * pull.by_covariance).astype(np.float32) @ batch.solved
    if pull.by_trend is not None:
        by_phi -= pull.by_trend.astype(np.float32) @ channel.trend.T.astype(np.float32)
        loss = rounded_log_distance(batch.ways_m.reshape(-1, 2), channel.parameters.station)
        found += pull.by_trend[:, :, 1:] * loss.gradient.reshape(found.shape)
    by_kernel = by_phi.reshape(batch.phi.shape)
    found += kernel_slopes(
        batch.ways_m, channel.positions_m, batch, by_kernel, batch.distance_m, batch.phi
    )
    return found


def kernel_slopes(
    ways_m: NDArray[np.float64],
    others_m: NDArray[np.float64],
    batch: WayBatch,
    by_kernel: NDArray[np.float32],
    distance_m: NDArray[np.float32],
    kernel: NDArray[np.float32],
) -> NDArray[np.float64]:
    """Through covariances (c N, m) of all places with `others_m` (m, 2); ``(c, N, 2)``.

    d k = -k / (beta r) (q - other), r not below the rounding of the kernel's cusp. `by_kernel` is
    overwritten.
    """
    beta = batch.channel.parameters.decorrelation_m
    by_kernel *= kernel
    by_kernel /= np.maximum(distance_m, np.float32(CUSP_ROUNDING * beta))
    middle = ways_m.reshape(-1, 2).mean(axis=0)
    pulled = by_kernel @ np.column_stack([others_m - middle, np.ones(len(others_m))]).astype(
        np.float32
    )
    pulled = pulled.astype(np.float64).reshape(*ways_m.shape[:2], 3)
    return (pulled[:, :, :2] - pulled[:, :, 2:] * (ways_m - middle)) / beta


def _between(batch: WayBatch, by_covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Through the prior covariances of a way's places with each other."""
    parameters = batch.channel.parameters
    offset = batch.ways_m[:, :, None] - batch.ways_m[:, None]
    slope = 2.0 * by_covariance * _slope_over_distance(offset, parameters)
    return (slope[:, :, :, None] * offset).sum(axis=2)


def _slope_over_distance(
    offset_m: NDArray[np.float64], parameters: ChannelParameters
) -> NDArray[np.float64]:
    """k'(r) / r of the kernel."""
    beta = parameters.decorrelation_m
    distance = np.hypot(offset_m[..., 0], offset_m[..., 1])
    kernel = parameters.shadow_std_db**2 * np.exp(-distance / beta)
    return -kernel / (beta * np.maximum(distance, CUSP_ROUNDING * beta))


def pull_of_legs(
    start_m: NDArray[np.float64], ways_m: NDArray[np.float64], by_length: NDArray[np.float64]
) -> Pull:
    """Return the pull by lengths (c, N) of the steps of ways (c, N, 2) from `start_m` (2,)."""
    ends = np.concatenate([np.broadcast_to(start_m, (len(ways_m), 1, 2)), ways_m], axis=1)
    legs = np.diff(ends, axis=1)
    length = np.maximum(np.hypot(legs[..., 0], legs[..., 1]), TINY_M)
    found = (by_length / length)[:, :, None] * legs
    found[:, :-1] -= found[:, 1:].copy()
    return Pull(by_place=found)


def single_kernel(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    parameters: ChannelParameters,
    added_m2: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distances of `a` (n, 2) from `b` (m, 2) and covariances of shadowing; both ``(n, m)``.

    Coordinates near 3e6 keep their digits: what is rounded are offsets from the middle of `a`.
    `added_m2` (m,) is added to the squares.
    """
    middle = a.mean(axis=0)
    from_m, to_m = (a - middle).astype(np.float32), (b - middle).astype(np.float32)
    distance = from_m[:, :1] - to_m[:, 0]
    distance *= distance
    dy = from_m[:, 1:] - to_m[:, 1]
    dy *= dy
    distance += dy
    if added_m2 is not None:
        distance += added_m2.astype(np.float32)
    np.sqrt(distance, out=distance)
    return distance, decayed_db2(distance.copy(), parameters)


NUGGET_SHARE = 1e-4
"""Least variance of multipath as a share of the shadowing's: without any, a place that is measured
twice would make the covariance singular."""


class WayBatch:
    """S and B of equation 1.11 for every path."""

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
            places, channel.positions_m, parameters, channel.added_m2
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
        """Return the region whose map is wanted."""
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


class ToldBatch:
    """S_g and B_g of every way."""

    def __init__(self, batch: WayBatch, gate: NDArray[np.float64] | None) -> None:
        self.batch, self.gate = batch, gate
        self.covariance, self.trend = batch.covariance, batch.trend
        self.blind_db2 = blind_variance_db2(batch.channel.parameters)
        if gate is None:
            return
        blind = self.blind_db2 * np.eye(batch.shape[1])
        self._told = batch.covariance - blind
        self.covariance = gate[:, :, None] * gate[:, None] * self._told + blind
        self.trend = gate[:, :, None] * batch.trend

    @cached_property
    def universal(self) -> NDArray[np.float64]:
        """S_g + B_g M B_g', ``(c, N, N)``."""
        if self.gate is None:
            return self.batch.universal
        pulled = self.trend @ self.batch.channel.theta_covariance
        return self.covariance + pulled @ self.trend.transpose(0, 2, 1)

    @cached_property
    def factor(self) -> NDArray[np.float64]:
        """Cholesky factors of :attr:`universal`."""
        return np.asarray(np.linalg.cholesky(self.universal), dtype=np.float64)

    @cached_property
    def inverse(self) -> NDArray[np.float64]:
        """Inverses of :attr:`universal`."""
        return np.asarray(np.linalg.inv(self.universal), dtype=np.float64)

    @cached_property
    def noise_db2(self) -> NDArray[np.float64]:
        """Variance at every place that is no channel's, ``(c, N)``: all of it where gates are 0."""
        noise = np.full(self.batch.shape, self.batch.channel.parameters.multipath_std_db**2)
        if self.gate is None:
            return noise
        return self.blind_db2 + self.gate**2 * (noise - self.blind_db2)

    @cached_property
    def across(self) -> NDArray[np.float32]:
        """c(g) weighted, of the gated measurements; ``(c, N, g)``."""
        across = self.batch.across[2]
        return across if self.gate is None else self.gate.astype(np.float32)[:, :, None] * across

    @property
    def grid(self) -> LocalGrid:
        """Return the region whose map is wanted."""
        return self.batch.required_grid

    def above_db2(self, threshold_db2: float) -> NDArray[np.float64]:
        """Return the excess of L_ii^2 over a threshold, times the squared gate; ``(c, N)``."""
        variance = np.diagonal(self.factor, axis1=1, axis2=2) ** 2
        if self.gate is not None:
            # With a gate g, L_ii^2 is kappa + g^2 (that of the whole measurement - kappa).
            variance = variance - self.blind_db2
            threshold = self.gate**2 * (threshold_db2 - self.blind_db2)
            return np.maximum(variance - threshold, 0.0)
        return np.maximum(variance - threshold_db2, 0.0)

    def pulled_back(self, pull: Pull) -> Pull:
        """Turn slopes by S_g, B_g and the gates into those by S, B and the gates."""
        if self.gate is None:
            return pull
        by_gate = np.zeros(self.batch.shape) if pull.by_gate is None else pull.by_gate.copy()
        by_covariance, by_trend = pull.by_covariance, pull.by_trend
        if by_covariance is not None:
            by_gate += 2.0 * np.einsum("cij,cij,cj->ci", by_covariance, self._told, self.gate)
            by_covariance = self.gate[:, :, None] * self.gate[:, None] * by_covariance
        if by_trend is not None:
            by_gate += (by_trend * self.batch.trend).sum(axis=2)
            by_trend = self.gate[:, :, None] * by_trend
        return Pull(pull.by_place, by_covariance, by_trend, pull.by_phi, by_gate)
