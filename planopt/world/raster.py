"""Maps of values on a regular grid, looked up at the nearest cell."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.keys import LARGEST_COORDINATE_M
from planopt.short_repr import short_repr

UNEVEN_CELLS = 1e-3
"""Tolerance of the grid spacing, in cells, since files may store coordinates as float32."""


@dataclass(frozen=True)
class Raster:
    """Map of values on a regular grid."""

    # (nx,) and (ny,) coordinates of the cell centres, ascending and evenly spaced
    x_m: Floats
    y_m: Floats
    values: Floats  # (ny, nx), row 0 at the smallest y; NaN if missing
    quantity: str = field(default="", repr=False)  # Such as "received power"; empty if unknown
    unit: str = field(default="", repr=False)

    __repr__ = short_repr

    @property
    def cell_m(self) -> tuple[float, float]:
        """Return the sides of a cell along x and y."""
        return _spacing(self.x_m), _spacing(self.y_m)


def checked_raster(x: Floats, y: Floats, values: Floats, variable: str) -> Raster:
    """Return the raster of axes and values after validation."""
    # Minus infinity, the decibel value of zero, becomes NaN.
    for name, axis in (("x", x), ("y", y)):
        if axis.ndim != 1 or axis.size < 2:
            raise InputError(
                f"has shape {axis.shape}, should be a one-dimensional array of at least two "
                "numbers",
                key=name,
                remedy="give the coordinates of cell centres in metres",
            )
        if not (np.abs(axis) <= LARGEST_COORDINATE_M).all():
            raise InputError(
                f"should have finite numbers within {LARGEST_COORDINATE_M:g} m of the origin",
                key=name,
                remedy="give metres from an origin near the map",
            )
        side = _spacing(axis)
        off = np.abs(axis - axis[0] - side * np.arange(axis.size))
        if not (side > 0.0 and (off <= UNEVEN_CELLS * side).all()):
            raise InputError(
                "should be ascending with equal spacing",
                key=name,
                remedy="sort the cell centres, reorder the values accordingly, and resample to one "
                "spacing",
            )
    if values.shape != (y.size, x.size):
        raise InputError(
            f"has shape {values.shape}, should have shape (y, x) = {(y.size, x.size)}",
            key=variable,
            remedy="rows are y and columns are x; transpose the array if necessary",
        )
    if np.isposinf(values).any():
        iy, ix = np.argwhere(np.isposinf(values))[0].tolist()
        raise InputError(
            f"is infinite at ({x[ix]:g}, {y[iy]:g}) m",
            key=variable,
            remedy="use NaN for missing values",
        )
    return Raster(x, y, np.where(np.isneginf(values), np.nan, values))


def cell_centres_m(low_m: float, high_m: float, cell_m: float) -> Floats:
    """Return the centres of the cells that cover an interval; at least two."""
    count = max(2, math.ceil((high_m - low_m) / cell_m))
    return low_m + cell_m * (np.arange(count, dtype=np.float64) + 0.5)


def nearest_cells(
    raster: Raster, positions_m: Floats
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column (n,) of the cell nearest to each position (n, 2)."""
    first = np.array([raster.x_m[0], raster.y_m[0]])
    last_cell = np.array([raster.x_m.size, raster.y_m.size]) - 1
    cells = np.floor((positions_m - first) / np.array(raster.cell_m) + 0.5)
    outside = ~((cells >= -1) & (cells <= last_cell + 1)).all(axis=1)
    if outside.any():
        x, y = positions_m[outside.argmax()]
        raise InputError(
            f"the position ({x:g}, {y:g}) m is outside the map, which covers x from "
            f"{raster.x_m[0]:g} to {raster.x_m[-1]:g} m and y from {raster.y_m[0]:g} to "
            f"{raster.y_m[-1]:g} m",
            remedy="use a larger map, or keep starts, goals and world.bounds_m within it; "
            "channel.truth.origin_deg places maps with a reference system in the frame",
        )
    ix, iy = np.clip(cells, 0, last_cell).astype(np.int64).T
    return iy, ix


def _spacing(axis_m: Floats) -> float:
    """Return the mean spacing of an axis."""
    return float(axis_m[-1] - axis_m[0]) / (axis_m.size - 1)
