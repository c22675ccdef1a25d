"""Grids of places over the workspace, and their connected parts."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label  # pyright: ignore[reportUnknownVariableType]


def grid_of(
    bounds_m: tuple[float, float, float, float],
    anchor_m: NDArray[np.float64],
    spacing_m: float,
    radius_m: float = np.inf,
) -> NDArray[np.float64]:
    """Places of a grid over the workspace, one of them the anchor, none far beyond the radius."""
    low = np.maximum(np.array(bounds_m[:2]) - anchor_m, -radius_m)
    high = np.minimum(np.array(bounds_m[2:]) - anchor_m, radius_m)
    columns = _steps_within(float(low[0]), float(high[0]), spacing_m)
    rows = _steps_within(float(low[1]), float(high[1]), spacing_m)
    grid = np.empty((len(rows), len(columns), 2))
    grid[..., 0] = anchor_m[0] + columns
    grid[..., 1] = anchor_m[1] + rows[:, None]
    return grid


def _steps_within(low: float, high: float, spacing: float) -> NDArray[np.float64]:
    """Multiples of the spacing between two offsets."""
    first, last = int(np.ceil(low / spacing)), int(np.floor(high / spacing))
    return spacing * np.arange(first, last + 1, dtype=np.float64)


def parts_of(passable: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Number the connected parts of a grid, corners connect; 0 where it is not passable."""
    numbered = cast(
        "tuple[object, int]", label(passable, structure=np.ones((3, 3), dtype=np.int32))
    )
    return np.asarray(numbered[0], dtype=np.int32)
