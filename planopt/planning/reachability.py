"""Whether the connectivity bound can be met at all: the verifier's own searches.

Within reach: the places searched contain every place that the robot could reach by a step (a disc
about it, cut to the free part connected with it), so a negative best margin says that the bound
cannot be met there. On the way to the goal: a flood of the places that keep the bound either comes
to the goal or shows that no such way is left. Both are as good as their grids, which the functions
name.
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

FLOOD_SPACING_STEPS = 0.5
"""Grid spacing of the flood in longest steps."""


def connected_way_exists(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    start_m: NDArray[np.float64],
    goal_m: NDArray[np.float64],
    clearance: float,
    step_length_m: float,
    within_m: float,
) -> bool:
    """Whether a way to the goal keeps the connectivity bound, from a place near the start.

    Floods a grid of half a step's spacing over the workspace, corners included, so that what it
    finds is at least what there is, but for ways narrower than the grid.

    Parameters
    ----------
    index, bounds_m
        The obstacles and the workspace.
    margin_db
        Positions (n, 2) to margins (n,).
    start_m, goal_m
        ``(2,)`` each.
    clearance, step_length_m
        The clearance that the robot must keep and its longest step, in metres.
    within_m
        Ways may begin at any place that keeps the bound and is at most this far from the start.
        With 0 they begin at the start itself, whatever its margin.
    """
    spacing = FLOOD_SPACING_STEPS * step_length_m
    x_min, y_min, x_max, y_max = bounds_m
    # Anchored at the start, so that it is a node.
    columns = _steps_within(x_min - start_m[0], x_max - start_m[0], spacing)
    rows = _steps_within(y_min - start_m[1], y_max - start_m[1], spacing)
    grid = np.empty((len(rows), len(columns), 2))
    grid[..., 0] = start_m[0] + columns
    grid[..., 1] = start_m[1] + rows[:, None]
    x, y = grid[..., 0], grid[..., 1]
    away = clearance_m(index, grid.reshape(-1, 2)).reshape(x.shape)
    # However coarse the grid is against the clearance, no way leads through an obstacle.
    open_ = (away > 0.0) & (away >= clearance - 0.5 * spacing)
    open_[open_] = margin_db(grid[open_]) >= 0.0
    from_start = np.hypot(x - start_m[0], y - start_m[1])
    if within_m == 0.0:
        open_[from_start < 0.5 * spacing] = True
    parts = _parts(open_)
    begins = parts[open_ & (from_start <= max(within_m, 0.5 * spacing))]
    at_goal = np.hypot(x - goal_m[0], y - goal_m[1]) <= spacing
    return bool(np.isin(parts[at_goal & open_], begins).any())


def _steps_within(low: float, high: float, spacing: float) -> NDArray[np.float64]:
    """Multiples of the spacing between two offsets."""
    first, last = int(np.ceil(low / spacing)), int(np.floor(high / spacing))
    return spacing * np.arange(first, last + 1, dtype=np.float64)


def _parts(passable: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Number the connected parts of a grid, corners connect; 0 where it is not passable."""
    numbered = cast(
        "tuple[object, int]", label(passable, structure=np.ones((3, 3), dtype=np.int32))
    )
    return np.asarray(numbered[0], dtype=np.int32)


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
    parts = _parts(passable)
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
