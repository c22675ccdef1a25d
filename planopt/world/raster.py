"""Maps on a regular grid, read from and written to ``npz`` and looked up at the nearest cell.

Other formats: :mod:`planopt.world.raster_files`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, listed
from planopt.files.npz import npz_names, read_npz
from planopt.short_repr import short_repr
from planopt.world.workspace import LARGEST_COORDINATE_M

QUANTITIES = "quantities"
"""Entry of an npz file with the name, quantity and unit of each variable, as text (k, 3)."""

UNEVEN_CELLS = 1e-3
"""How far, in cells, a coordinate may be off the even grid: float32 files are."""


@dataclass(frozen=True)
class Raster:
    """Values on a regular grid."""

    # (nx,) and (ny,) coordinates of the cell centres, ascending and evenly spaced
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    values: NDArray[np.float64]  # (ny, nx), row 0 at the smallest y. NaN where there is no value.
    quantity: str = field(default="", repr=False)  # Such as "received power"; empty if not known
    unit: str = field(default="", repr=False)

    __repr__ = short_repr

    @property
    def cell_m(self) -> tuple[float, float]:
        """Cell sides along x and y."""
        return _spacing(self.x_m), _spacing(self.y_m)


def read_npz_raster(path: Path, variable: str) -> Raster:
    """Read one variable of an ``npz`` file with its axes ``x`` and ``y``."""
    x, y, values = npz_arrays(path, ("x", "y", variable))
    table = read_npz(path, (QUANTITIES,)).get(QUANTITIES, np.zeros((0, 3), dtype="U1"))
    rows: list[Any] = table.tolist() if table.dtype.kind == "U" and table.ndim == 2 else []
    known: dict[str, list[str]] = {row[0]: row[1:] for row in rows if len(row) == 3}
    quantity, unit = known.get(variable, ("", ""))
    return replace(checked_raster(x, y, values, path, variable), quantity=quantity, unit=unit)


def write_npz(path: Path, rasters: Mapping[str, Raster]) -> None:
    """Write rasters of the same axes as an ``npz`` file with the axes ``x`` and ``y``."""
    first = next(iter(rasters.values()))
    arrays: dict[str, Any] = {name: raster.values for name, raster in rasters.items()}
    arrays[QUANTITIES] = [(name, each.quantity, each.unit) for name, each in rasters.items()]
    # Given a name, NumPy would add its own ending to one in capitals.
    with path.open("wb") as file:
        np.savez_compressed(file, x=first.x_m, y=first.y_m, **arrays)


def checked_raster(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    values: NDArray[np.float64],
    path: Path | None,
    variable: str,
) -> Raster:
    """The raster of arrays that were read from `path`; None if they are from no file.

    Minus infinity, the decibels of nothing, becomes NaN.
    """
    for name, axis in (("x", x), ("y", y)):
        if axis.ndim != 1 or axis.size < 2:
            raise InputError(
                f"shape {axis.shape} is not an axis of cells",
                file=path,
                key=name,
                remedy="give the coordinates of cell centres in metres",
            )
        if not (np.abs(axis) <= LARGEST_COORDINATE_M).all():
            raise InputError(
                f"cell centres must be finite and within {LARGEST_COORDINATE_M:g} m of the origin",
                file=path,
                key=name,
                remedy="give metres, with an origin near the map",
            )
        if not _is_even(axis):
            raise InputError(
                "cell centres must be ascending and evenly spaced",
                file=path,
                key=name,
                remedy="sort them and resample to one spacing, flip the values alike",
            )
    if values.shape != (y.size, x.size):
        raise InputError(
            f"shape {values.shape} does not fit the axes, (y, x) = {(y.size, x.size)}",
            file=path,
            key=variable,
            remedy="give one value for each y (rows) and x (columns), perhaps transposed",
        )
    if np.isposinf(values).any():
        iy, ix = np.argwhere(np.isposinf(values))[0].tolist()
        raise InputError(
            f"is infinite at ({x[ix]:g}, {y[iy]:g}) m",
            file=path,
            key=variable,
            remedy="write NaN where there is no value",
        )
    return Raster(x, y, np.where(np.isneginf(values), np.nan, values))


def cell_centres_m(low_m: float, high_m: float, cell_m: float) -> NDArray[np.float64]:
    """Centres of the cells that cover an interval; two at least, a raster's spacing needs them."""
    count = max(2, math.ceil((high_m - low_m) / cell_m))
    return low_m + cell_m * (np.arange(count, dtype=np.float64) + 0.5)


def nearest_cells(
    raster: Raster, positions_m: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The cell that every position is nearest to."""
    # Shapes: positions_m (n, 2); returns (n,).
    first = np.array([raster.x_m[0], raster.y_m[0]])
    last_cell = np.array([raster.x_m.size, raster.y_m.size]) - 1
    cells = np.floor((positions_m - first) / np.array(raster.cell_m) + 0.5)
    outside = ~((cells >= -1) & (cells <= last_cell + 1)).all(axis=1)
    if outside.any():
        x, y = positions_m[outside.argmax()]
        raise InputError(
            f"position ({x:g}, {y:g}) is outside the map, which covers x from {raster.x_m[0]:g} "
            f"to {raster.x_m[-1]:g} and y from {raster.y_m[0]:g} to {raster.y_m[-1]:g} m",
            remedy="give a larger map, or keep starts, goals and bounds within it",
        )
    ix, iy = np.clip(cells, 0, last_cell).astype(np.int64).T
    return iy, ix


def _spacing(axis_m: NDArray[np.float64]) -> float:
    """Mean distance of neighbours."""
    return float(axis_m[-1] - axis_m[0]) / (axis_m.size - 1)


def _is_even(axis_m: NDArray[np.float64]) -> bool:
    """Return whether finite coordinates are ascending and evenly spaced."""
    if not axis_m[-1] > axis_m[0]:
        return False
    off = axis_m - axis_m[0] - _spacing(axis_m) * np.arange(axis_m.size)
    return bool((np.abs(off) <= UNEVEN_CELLS * _spacing(axis_m)).all())


def npz_arrays(path: Path, names: tuple[str, ...]) -> list[NDArray[np.float64]]:
    """Return arrays of an npz file as floats."""
    arrays = read_npz(path, names)
    found: list[NDArray[np.float64]] = []
    for name in names:
        if name not in arrays:
            raise InputError(
                f"the file holds no {name!r}",
                file=path,
                remedy=f"it holds {listed(npz_names(path))}",
            )
        if arrays[name].dtype.kind not in "biuf":
            raise InputError(
                f"{arrays[name].dtype} is not numeric", file=path, key=name, remedy="give numbers"
            )
        with np.errstate(all="ignore"):  # from longer floats
            found.append(arrays[name].astype(np.float64))
    return found
