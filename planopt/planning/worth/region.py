"""Where in the workspace a map is wanted: a grid over the places a robot may be at."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.mapping import Region
from planopt.problems.problem import Problem
from planopt.world.clearance import clearance_m, index_obstacles

PLACES = 200
"""About how many places stand for the workspace."""

NEAR_PLACES = 900
"""About how many stand for the part of it that a plan can change."""

ROOM_STEPS = 5.0
"""How far beyond the reachable places that part goes, in longest steps: what is measured tells of
places around, of those nearer than other measurements."""


def workspace_region(problem: Problem) -> Region:
    """Cell centres of a square grid over the workspace outside obstacles, of equal weight."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    grid = _centres((x_min, y_min, x_max, y_max), _coarse_m(problem))
    free = grid[clearance_m(index_obstacles(problem.workspace), grid) > 0.0]
    places = free if len(free) else grid
    return Region(places, np.full(len(places), 1.0 / len(places)))


def region_near(problem: Problem, whole: Region, position_m: NDArray[np.float64]) -> Region:
    """The workspace as a plan from `position_m` (2,) sees it: fine where it can change anything.

    On the coarse grid a plan is worth most where it passes through the grid's own places, and far
    less between them.

    Parameters
    ----------
    problem
        Horizon, longest step and workspace.
    whole
        Its :func:`workspace_region`.
    position_m
        Where the robot is.
    """
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    reach = problem.step_length_m * (problem.planner.horizon + ROOM_STEPS)
    low = np.maximum(position_m - reach, (x_min, y_min))
    high = np.minimum(position_m + reach, (x_max, y_max))
    side = high - low
    cell, coarse = math.sqrt(float(side.prod()) / NEAR_PLACES), _coarse_m(problem)
    if not (side > 0.0).all() or cell >= coarse:
        return whole
    near = _centres((low[0], low[1], high[0], high[1]), cell)
    near = near[clearance_m(index_obstacles(problem.workspace), near) > 0.0]
    far = whole.grid_m[~((whole.grid_m >= low) & (whole.grid_m <= high)).all(axis=1)]
    weight = np.concatenate([np.full(len(near), cell**2), np.full(len(far), coarse**2)])
    if not len(weight):
        return whole
    return Region(np.concatenate([near, far]), weight / weight.sum())


def region_along(problem: Problem, region: Region, path_m: NDArray[np.float64]) -> Region:
    """The part of `region` that paths near `path_m` (N, 2) can change; weights as they are."""
    away = np.linalg.norm(region.grid_m[:, None] - path_m, axis=2).min(axis=1)
    near = away <= ROOM_STEPS * problem.step_length_m
    return Region(region.grid_m[near], region.weight[near]) if near.any() else region


def _coarse_m(problem: Problem) -> float:
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    return math.sqrt((x_max - x_min) * (y_max - y_min) / PLACES)


def _centres(bounds_m: tuple[float, float, float, float], cell_m: float) -> NDArray[np.float64]:
    """Centres of cells of about this size, row by row; (n, 2)."""
    x_min, y_min, x_max, y_max = bounds_m
    x, y = (
        low + (high - low) * (np.arange(count) + 0.5) / count
        for low, high in ((x_min, x_max), (y_min, y_max))
        for count in (max(1, round((high - low) / cell_m)),)
    )
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
