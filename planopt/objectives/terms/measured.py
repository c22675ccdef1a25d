"""Sums over stations and node rewards of the terms whose value is what measurements tell."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.terms.context import NodeChannel, Nodes, StepContext


def added(parts: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the sum over stations: information of independent ones adds up."""
    first, *others = parts
    for other in others:
        first = first + other
    return first


def added_derivatives(parts: Iterable[PathDerivatives]) -> PathDerivatives:
    """Return the sum over stations of values with derivatives."""
    first, *others = parts
    for other in others:
        first = PathDerivatives(
            first.value + other.value,
            first.gradient + other.gradient,
            first.hessian + other.hessian,
        )
    return first


def measured_reward(
    at: StepContext,
    nodes: Nodes,
    told: Callable[[NodeChannel, ChannelPosterior], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return what measuring at each node alone would tell of all stations; (ny, nx)."""
    near = nodes.grid_m[nodes.window]
    found = added(
        told(
            station if posterior is now else _anticipated(station, posterior, nodes, near),
            posterior,
        )
        for station, now, posterior in zip(nodes.stations, at.stations, at.anticipated, strict=True)
    )
    # A node that is measured already brings nothing.
    is_open = np.ones(found.shape, dtype=np.bool_)
    is_open[nodes.window] = at.near_measuring.is_open(near.reshape(-1, 2)).reshape(near.shape[:2])
    found[~is_open] = 0.0
    return found


@dataclass(frozen=True, eq=False)
class _Anticipated:
    """A station's predictions at the nodes, the others' measurements counted within reach."""

    mean_db: NDArray[np.float64]
    deviation_db: NDArray[np.float64]
    trend: NDArray[np.float64]


def _anticipated(
    station: NodeChannel,
    posterior: ChannelPosterior,
    nodes: Nodes,
    near_m: NDArray[np.float64],
) -> _Anticipated:
    known = np.isfinite(station.deviation_db[nodes.window])
    spread = np.full(known.shape, np.nan)
    if known.any():
        spread[known] = posterior.predict(near_m[known]).deviation_db
    deviation = station.deviation_db.copy()
    deviation[nodes.window] = spread
    return _Anticipated(station.mean_db, deviation, station.trend)
