"""Places drawn from a region."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.voronoi import ConvexRegion


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
