"""Whether the connectivity bound can be met at all within reach: the verifier's own search.

The places searched contain every place that the robot could reach by a step (a disc about it, cut
to the free part connected with it), so a negative best margin says that the bound cannot be met
there, up to the resolution of the search: a grid over the disc, refined twice about its best
places.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label  # pyright: ignore[reportUnknownVariableType]

from planopt.world.clearance import ObstacleIndex, clearance_m

GRID_STEPS = 12
"""Grid nodes along the radius of the disc."""
REFINED_NODES = 24
"""How many of the best nodes each refinement looks around."""
REFINEMENTS = 2
"""How often the grid is refined, each time to a quarter of the spacing."""


def best_margin_within_reach(
    index: ObstacleIndex,
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    start_m: NDArray[np.float64],
    radius_m: float,
    clearance: float,
) -> float:
    """Largest connectivity margin (dB) over the places within `radius_m` of `start_m`.

    Parameters
    ----------
    index
        The obstacles.
    margin_db
        Positions (n, 2) to margins (n,).
    start_m
        ``(2,)`` where the robot is.
    radius_m
        How far it can get.
    clearance
        The clearance it must keep, in metres.
    """
    steps = np.arange(-GRID_STEPS, GRID_STEPS + 1)
    spacing = radius_m / GRID_STEPS
    x, y = np.meshgrid(steps * spacing, steps * spacing)
    grid = start_m + np.stack([x, y], axis=-1)
    # A path may pass between nodes that are all a little too near to an obstacle.
    passable = clearance_m(index, grid.reshape(-1, 2)).reshape(x.shape) >= clearance - spacing
    passable[GRID_STEPS, GRID_STEPS] = True
    parts, _ = cast(
        "tuple[NDArray[np.int32], int]", label(passable, structure=np.ones((3, 3), dtype=np.int32))
    )
    reachable = (parts == parts[GRID_STEPS, GRID_STEPS]) & (np.hypot(x, y) <= radius_m)
    places = grid[reachable]
    margins = margin_db(places)
    best = float(margins.max())
    around = np.stack(np.meshgrid([-0.5, -0.25, 0.0, 0.25, 0.5], [-0.5, -0.25, 0.0, 0.25, 0.5]), -1)
    for _ in range(REFINEMENTS):
        top = places[np.argsort(-margins)[:REFINED_NODES]]
        places = (top[:, None] + spacing * around.reshape(1, -1, 2)).reshape(-1, 2)
        places = places[np.linalg.norm(places - start_m, axis=1) <= radius_m]
        places = places[clearance_m(index, places) >= clearance]
        if len(places) == 0:
            break
        margins = margin_db(places)
        best = max(best, float(margins.max()))
        spacing /= 4.0
    return best
