"""Positions drawn from a region, and moves of agents."""

import numpy as np
from numpy.typing import NDArray

from planopt.coverage import ConvexRegion, Motion, MoveLimits


def scattered(
    region: ConvexRegion, count: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Draw places (count, 2) uniformly from a region."""
    low, high = region.corners_m.min(axis=0), region.corners_m.max(axis=0)
    found = np.zeros((0, 2))
    while len(found) < count:
        drawn = low + (high - low) * generator.random((4 * count, 2))
        found = np.concatenate((found, drawn[region.excess_m(drawn) < 0.0]))
    return found[:count]


def swept(before: Motion, after: Motion, limits: MoveLimits) -> NDArray[np.float64]:
    share, bend = np.linspace(0.0, 1.0, 9)[:, None, None], np.zeros_like(before.places_m)
    if limits.acceleration_m_s2 is not None:
        bend = 0.5 * limits.time_step_s * (before.velocities_m_s - after.velocities_m_s)
    move = after.places_m - before.places_m
    return before.places_m + share * move + share * (1.0 - share) * bend
