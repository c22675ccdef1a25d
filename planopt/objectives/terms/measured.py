"""Sums over stations and node rewards of the terms whose value is what measurements tell."""

from __future__ import annotations

from collections.abc import Callable, Iterable

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
    """Return what measuring at each node alone would tell of all stations; (ny, nx).

    Parameters
    ----------
    at
        What is known.
    nodes
        The lattice.
    told
        What measuring one station at each node tells.
    """
    found = added(
        told(station, posterior)
        for station, posterior in zip(nodes.stations, at.stations, strict=True)
    )
    # A node that is measured already brings nothing.
    is_open = np.ones(found.shape, dtype=np.bool_)
    near = nodes.grid_m[nodes.window]
    is_open[nodes.window] = at.near_measuring.is_open(near.reshape(-1, 2)).reshape(near.shape[:2])
    found[~is_open] = 0.0
    return found
