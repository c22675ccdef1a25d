"""Metres gained along a way that a robot is steered along, summed over the steps' ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.terms.context import NearPath, Nodes, Paths, StepContext
from planopt.objectives.told_batch import TINY_M, Pull, WayBatch
from planopt.targets.rounding import Derivatives, rounded_length


def gained_m(at: StepContext, path_m: NDArray[np.float64]) -> float:
    """Return by how much the places of a path (N, 2) are nearer to the end, summed."""
    return 0.0 if at.steering is None else float(at.steering.gained_m(path_m))


def gains_m(paths: Paths) -> NDArray[np.float64]:
    """Return the same of many paths; ``(c,)``."""
    if paths.at.steering is None:
        return np.zeros(paths.shape[0])
    return paths.at.steering.gained_m(paths.ways_m)


def gained_derivatives(path: NearPath) -> Derivatives:
    """Return minus the distance of every place to the next turn of the way, with derivatives."""
    steering, places = path.at.steering, path.places_m
    if path.ahead is None or steering is None:
        count = len(places)
        return Derivatives(np.zeros(count), np.zeros((count, 2)), np.zeros((count, 3)))
    distance = rounded_length(places - steering.turns_m[path.ahead], path.rounding_m)
    return Derivatives(-distance.value, -distance.gradient, -distance.hessian)


def gained_slope(at: StepContext, batch: WayBatch) -> Pull:
    """Return derivatives of :func:`gains_m` by the places of paths."""
    if at.steering is None:
        return Pull()
    turns = at.steering.next_turns(batch.ways_m.reshape(-1, 2))
    offset = at.steering.turns_m[turns].reshape(batch.ways_m.shape) - batch.ways_m
    return Pull(by_place=offset / np.maximum(np.linalg.norm(offset, axis=2), TINY_M)[:, :, None])


def gained_reward(at: StepContext, nodes: Nodes) -> NDArray[np.float64]:
    """Return minus the way that is left from each node of a lattice; ``(ny, nx)``."""
    shape, steering = nodes.grid_m.shape[:2], at.steering
    if steering is None:
        return np.zeros(shape)
    if steering.lattice_m is not None:
        return -steering.lattice_m
    return -steering.distance_m(nodes.grid_m.reshape(-1, 2)).reshape(shape)
