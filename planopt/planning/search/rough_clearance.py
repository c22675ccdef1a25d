"""About how far places are from obstacles and borders: a raster that is looked up, not searched.

For steering many ways at once, where exact distances would cost more than all the rest. What comes
out is checked exactly afterwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, clearance_m

CELLS_PER_STEP = 4.0
"""Cells of the raster along a longest step."""

MAX_CELLS = 250_000
"""A raster of more would be coarser instead."""


@dataclass(frozen=True, eq=False)
class RoughClearance:
    """Distances at the corners of square cells over the workspace.

    Attributes
    ----------
    origin_m
        ``(2,)`` of corner ``[0, 0]``.
    cell_m
        Side of a cell.
    distance_m
        ``(ny, nx)`` to the nearest obstacle, none farther than `far_m`.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``.
    """

    origin_m: NDArray[np.float64]
    cell_m: float
    distance_m: NDArray[np.float64]
    bounds_m: tuple[float, float, float, float]

    def is_free(self, places_m: NDArray[np.float64], clearance: float) -> NDArray[np.bool_]:
        """Whether places (..., 2) are within bounds and about `clearance` from obstacles; (...)."""
        x_min, y_min, x_max, y_max = self.bounds_m
        x, y = places_m[..., 0], places_m[..., 1]
        inside = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)
        ny, nx = self.distance_m.shape
        across = np.clip((x - self.origin_m[0]) / self.cell_m, 0.0, nx - 1.000001)
        up = np.clip((y - self.origin_m[1]) / self.cell_m, 0.0, ny - 1.000001)
        column, row = across.astype(np.intp), up.astype(np.intp)
        u, v = across - column, up - row
        d, at = self.distance_m.ravel(), row * nx + column
        below = (1.0 - u) * d[at] + u * d[at + 1]
        above = (1.0 - u) * d[at + nx] + u * d[at + nx + 1]
        return inside & ((1.0 - v) * below + v * above >= clearance)


def rough_clearance(problem: Problem, index: ObstacleIndex) -> RoughClearance:
    """Measure the corners of all cells once."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    width, height = x_max - x_min, y_max - y_min
    cell = max(problem.step_length_m / CELLS_PER_STEP, math.sqrt(width * height / MAX_CELLS))
    nx, ny = math.ceil(width / cell) + 2, math.ceil(height / cell) + 2
    corners = np.empty((ny, nx, 2))
    corners[..., 0] = x_min + cell * np.arange(nx)
    corners[..., 1] = y_min + cell * np.arange(ny)[:, None]
    far = width + height
    distance = np.minimum(clearance_m(index, corners.reshape(-1, 2)), far).reshape(ny, nx)
    return RoughClearance(np.array([x_min, y_min]), cell, distance, problem.workspace.bounds_m)
