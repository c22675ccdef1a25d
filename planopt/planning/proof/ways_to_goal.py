"""Whether a way to the goal keeps the connectivity bound, and what any way misses: searches.

A flood of the places that keep the bound either comes to the goal or shows that no such way is
left. Both searches are as good as their grid, which they name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra  # pyright: ignore[reportUnknownVariableType]

from planopt.planning.proof.grid import grid_of, parts_of
from planopt.world.clearance import ObstacleIndex, clearance_m

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
    grid, open_ = _open_grid(index, bounds_m, start_m, clearance, spacing)
    x, y = grid[..., 0], grid[..., 1]
    open_[open_] = margin_db(grid[open_]) >= 0.0
    from_start = np.hypot(x - start_m[0], y - start_m[1])
    if within_m == 0.0:
        open_[from_start < 0.5 * spacing] = True
    parts = parts_of(open_)
    begins = parts[open_ & (from_start <= max(within_m, 0.5 * spacing))]
    at_goal = np.hypot(x - goal_m[0], y - goal_m[1]) <= spacing
    return bool(np.isin(parts[at_goal & open_], begins).any())


def least_outage_m(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    places_m: NDArray[np.float64],
    goal_m: NDArray[np.float64],
    clearance: float,
    step_length_m: float,
) -> NDArray[np.float64]:
    """Least length below the bound on a way from each place to the goal, in metres; (n,).

    By Dijkstra's algorithm on a grid of half a step's spacing, corners included; infinite where
    obstacles cut a place off. An edge counts as below the bound by the share of its ends that are.

    Parameters
    ----------
    places_m
        ``(n, 2)`` the first is a node of the grid; every other takes its nearest open node's value.
    index, bounds_m, margin_db, goal_m, clearance, step_length_m
        As for :func:`connected_way_exists`.
    """
    spacing = FLOOD_SPACING_STEPS * step_length_m
    grid, open_ = _open_grid(index, bounds_m, places_m[0], clearance, spacing)
    number = np.full(open_.shape, -1)
    number[open_] = np.arange(int(open_.sum()))
    nodes = grid[open_]
    below = margin_db(nodes) < 0.0
    ends: list[NDArray[np.intp]] = []
    high, wide = len(grid), len(grid[0])
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = number[: high - down, max(0, -right) : wide - max(0, right)]
        other = number[down:, max(0, right) : wide + min(0, right)]
        both = (one >= 0) & (other >= 0)
        ends.append(np.stack([one[both], other[both]]))
    first, second = np.concatenate(ends, axis=1)
    length = np.linalg.norm(nodes[first] - nodes[second], axis=1)
    # An edge of no cost would be no edge to the solver; a millionth keeps ways short among equals.
    outage = length * (0.5 * (below[first].astype(float) + below[second]) + 1e-6)
    graph = csr_matrix((outage, (first, second)), shape=(len(nodes), len(nodes)))
    goal = int(np.argmin(np.linalg.norm(nodes - goal_m, axis=1)))
    from_goal = cast("NDArray[np.float64]", dijkstra(graph, directed=False, indices=goal))
    nearest = [int(np.argmin(np.linalg.norm(nodes - place, axis=1))) for place in places_m]
    return from_goal[nearest]


def _open_grid(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    anchor_m: NDArray[np.float64],
    clearance: float,
    spacing_m: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Places of a grid with the anchor among them, and whether a way may lead there."""
    grid = grid_of(bounds_m, anchor_m, spacing_m)
    away = clearance_m(index, grid.reshape(-1, 2)).reshape(grid.shape[:2])
    # However coarse the grid is against the clearance, no way leads through an obstacle.
    open_ = (away > 0.0) & (away >= clearance - 0.5 * spacing_m)
    return grid, open_
