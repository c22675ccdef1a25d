"""Where in the workspace a map is wanted: a grid over the places a robot may be at."""

from __future__ import annotations

import math

import numpy as np

from planopt.objectives.mapping import Region
from planopt.problems.problem import Problem
from planopt.world.clearance import clearance_m, index_obstacles

PLACES = 200
"""About how many places stand for the workspace."""


def workspace_region(problem: Problem) -> Region:
    """Cell centres of a square grid over the workspace outside obstacles, of equal weight."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    cell = math.sqrt((x_max - x_min) * (y_max - y_min) / PLACES)
    x, y = (
        low + (high - low) * (np.arange(count) + 0.5) / count
        for low, high in ((x_min, x_max), (y_min, y_max))
        for count in (max(1, round((high - low) / cell)),)
    )
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    free = grid[clearance_m(index_obstacles(problem.workspace), grid) > 0.0]
    places = free if len(free) else grid
    return Region(places, np.full(len(places), 1.0 / len(places)))
