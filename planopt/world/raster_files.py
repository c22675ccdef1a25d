"""Raster files of any format that planopt knows, chosen by the ending of the name.

Rasters as CSV: a row for each cell with its centre ``x_m, y_m`` and a column a variable.

Radio maps of Sionna RT, saved from Python with ``numpy.savez``.

``savez(file, path_gain=map.path_gain.numpy(), cell_centers=map.cell_centers.numpy())`` keeps what
is needed. Gains are linear there, and zero means that no path was found.
"""

from __future__ import annotations

import csv
import io
import math
import re
from array import array
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, listed
from planopt.files.npz import npz_names
from planopt.files.reading import read_text
from planopt.files.writing import write_whole
from planopt.world.raster import Raster, checked_raster, npz_arrays, read_npz_raster, write_npz
from planopt.world.raster_geotiff import import_rasterio, read_geotiff, write_geotiff
from planopt.world.raster_netcdf import read_netcdf, write_netcdf

AXES = ("x_m", "y_m")

DIGITS = "%.12g"
"""Twelve digits keep a millimetre in any coordinate, and more than any power has."""


def write_csv(path: Path, rasters: Mapping[str, Raster]) -> None:
    """Write rasters of the same axes, row by row from the smallest y; no value is ``nan``."""
    first = next(iter(rasters.values()))
    x, y = np.meshgrid(first.x_m, first.y_m)
    columns = [x, y, *(raster.values for raster in rasters.values())]
    table = np.column_stack([column.ravel() for column in columns])
    header = ",".join((*AXES, *rasters))
    np.savetxt(path, table, fmt=DIGITS, delimiter=",", header=header, comments="")


def read_csv(path: Path, variable: str) -> Raster:
    """Read one variable; rows may come in any order, an empty cell or ``nan`` is no value."""
    text = read_text(path)
    rows = csv.reader(io.StringIO(text))
    no_cells: list[str] = []
    # A third of the memory of lists of floats.
    numbers = array("d")
    try:
        header = [name.strip() for name in next(rows, no_cells)]
        where = [_column(header, name, path) for name in (*AXES, variable)]
        for cells in rows:
            if cells:
                numbers.extend(_number(cells, at, path, rows.line_num, header[at]) for at in where)
    except csv.Error as error:
        raise InputError(
            f"not a CSV row: {error}",
            file=path,
            row=rows.line_num,
            remedy="save the map as CSV with commas",
        ) from error
    return _on_grid(np.array(numbers).reshape(-1, 3), path, variable)


def _on_grid(table: NDArray[np.float64], path: Path, variable: str) -> Raster:
    """The raster whose cells are the rows x, y, value."""
    if not np.isfinite(table[:, :2]).all():
        raise InputError(
            "a cell centre is not finite", file=path, remedy="leave rows without a place out"
        )
    x, ix = np.unique(table[:, 0], return_inverse=True)
    y, iy = np.unique(table[:, 1], return_inverse=True)
    if len(np.unique(iy * x.size + ix)) != len(table) or len(table) != x.size * y.size:
        raise InputError(
            f"{len(table)} rows are not each cell of a grid of {y.size} x {x.size} once",
            file=path,
            remedy="give a row for each cell, nan where there is no value",
        )
    values = np.empty((y.size, x.size))
    values[iy, ix] = table[:, 2]
    return checked_raster(x, y, values, path, variable)


def _column(header: list[str], name: str, path: Path) -> int:
    if header.count(name) != 1:
        raise InputError(
            f"the file has no column {name!r}" if name not in header else f"two columns {name!r}",
            file=path,
            key=name,
            remedy=f"it has {listed(header)}",
        )
    return header.index(name)


def _number(cells: list[str], at: int, path: Path, row: int, name: str) -> float:
    if at >= len(cells):
        raise InputError(
            "the row is too short",
            file=path,
            key=name,
            row=row,
            remedy="give each row as many cells as the header",
        )
    cell = cells[at].strip()
    try:
        return float(cell) if cell else math.nan
    except ValueError:
        raise InputError(
            f"{cell!r} is not a number",
            file=path,
            key=name,
            row=row,
            remedy="write a number, or leave the cell empty where nothing is known",
        ) from None


CENTRES = "cell_centers"

TURNED_M = 1e-2
"""How far, in metres, a centre may be off its row or column: Sionna computes in float32."""


def read_sionna_map(path: Path, variable: str) -> Raster:
    """Read a linear quantity of a planar radio map in dB."""
    name, index = _name_and_index(variable)
    gain, centres = npz_arrays(path, (name, CENTRES))
    if gain.ndim == 3:
        if index is None and len(gain) != 1:
            raise InputError(
                f"there are {len(gain)} transmitters", file=path, key=name, remedy=f"say {name}[0]"
            )
        if (index or 0) >= len(gain):
            raise InputError(
                f"there is no transmitter {index}, only {len(gain)}, counted from 0",
                file=path,
                key=name,
                remedy="name one that is there",
            )
        gain = gain[index or 0]
    if gain.ndim != 2 or centres.shape != (*gain.shape, 3):
        raise InputError(
            f"shapes {gain.shape} and {centres.shape} are not of a planar map", file=path, key=name
        )
    if not gain.size:
        raise InputError("the map has no cells", file=path, key=name)
    x, y = centres[0, :, 0], centres[:, 0, 1]
    with np.errstate(all="ignore"):  # centres that are not finite
        off = np.maximum(np.abs(centres[..., 0] - x), np.abs(centres[..., 1] - y[:, None]))
    # Written so that a centre that is NaN counts as off.
    if not (off <= TURNED_M).all():
        raise InputError(
            "the map's plane is turned: rows do not run along x",
            file=path,
            key=CENTRES,
            remedy="make the map of a plane whose rows run along x",
        )
    if (gain < 0.0).any():
        raise InputError(
            "a linear gain is negative",
            file=path,
            key=name,
            remedy="give path gains, not decibels, or name the variable that has decibels",
        )
    decibels = np.full(gain.shape, np.nan)
    np.log10(gain, out=decibels, where=gain > 0.0)
    return checked_raster(x, y, 10.0 * decibels, path, variable)


def _name_and_index(variable: str) -> tuple[str, int | None]:
    """``path_gain[2]`` as its parts."""
    match = re.fullmatch(r"(.+)\[(\d{1,6})\]", variable)
    return (variable, None) if match is None else (match[1], int(match[2]))


def _read_any_npz(path: Path, variable: str) -> Raster:
    """Sionna RT's if it holds cell centres, planopt's otherwise, whose errors are the clearer."""
    read = read_sionna_map if CENTRES in npz_names(path) else read_npz_raster
    return read(path, variable)


READERS: dict[str, Callable[[Path, str], Raster]] = {
    ".csv": read_csv,
    ".npz": _read_any_npz,
    ".nc": read_netcdf,
    ".tif": read_geotiff,
    ".tiff": read_geotiff,
}
"""What reads a file of each ending."""

GEOTIFF = (".tif", ".tiff")


def read_raster(path: Path, variable: str) -> Raster:
    """Read one variable of a raster file."""
    return READERS[raster_ending(path)](path, variable)


def write_rasters(path: Path, rasters: Mapping[str, Raster]) -> None:
    """Write rasters of the same axes into one file, whole or not at all."""
    check_raster_output(path)
    ending = raster_ending(path)

    def write(temporary: Path) -> None:
        if ending == ".csv":
            write_csv(temporary, rasters)
        elif ending == ".npz":
            write_npz(temporary, rasters)
        elif ending == ".nc":
            write_netcdf(temporary, rasters)
        else:
            write_geotiff(temporary, rasters)

    write_whole(path, write)


def check_raster_output(path: Path) -> None:
    """Raise what :func:`write_rasters` would raise for the name, before any work is done."""
    if raster_ending(path) in GEOTIFF:
        import_rasterio(path)


def raster_ending(path: Path) -> str:
    """The ending of a raster file, in small letters."""
    ending = path.suffix.lower()
    if ending not in READERS:
        raise InputError(
            f"{ending or 'a name without ending'!r} is no format of maps",
            file=path,
            remedy=f"end the name in one of {', '.join(READERS)}",
        )
    return ending
