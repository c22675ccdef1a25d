"""From slopes by the numbers of a batch of ways to slopes by their places: the chain rule back.

Whatever a term does with S and B, its derivatives by the places follow from those by S, by B and by
the covariances with the measurements, at the cost of one more valuation for all ways together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import ChannelParameters
from planopt.objectives.local_channel import LocalChannel
from planopt.objectives.measuring import Gates
from planopt.objectives.rounded_kernel import CUSP_ROUNDING, rounded_log_distance
from planopt.objectives.way_batch import WayBatch

Real = TypeVar("Real", np.float32, np.float64)

TINY_M = 1e-9
"""Places nearer than this have no direction from each other."""


@dataclass(frozen=True, eq=False)
class Pull:
    """Derivatives of one number of each way by the numbers that it is made of; None where zero.

    Attributes
    ----------
    by_place
        ``(c, N, 2)`` by the places themselves, all else held.
    by_covariance
        ``(c, N, N)`` by S, symmetric.
    by_trend
        ``(c, N, 2)`` by B.
    by_phi
        ``(c, N, m)`` by the covariances with the measurements, S and B held.
    by_gate
        ``(c, N)`` by the gates of the places.
    """

    by_place: NDArray[np.float64] | None = None
    by_covariance: NDArray[np.float64] | None = None
    by_trend: NDArray[np.float64] | None = None
    by_phi: NDArray[np.float32] | None = None
    by_gate: NDArray[np.float64] | None = None

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
    """By mean and deviation of the power at every place, both ``(c, N)``."""
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
    """By B = `trend` (c, N, 2), through B M B', from derivatives by S + B M B' (c, N, N)."""
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
    """By the lengths (c, N) of the steps of ways (c, N, 2) from `start_m` (2,)."""
    ends = np.concatenate([np.broadcast_to(start_m, (len(ways_m), 1, 2)), ways_m], axis=1)
    legs = np.diff(ends, axis=1)
    length = np.maximum(np.hypot(legs[..., 0], legs[..., 1]), TINY_M)
    found = (by_length / length)[:, :, None] * legs
    found[:, :-1] -= found[:, 1:].copy()
    return Pull(by_place=found)
