"""Rasters as CSV: a row for each cell with its centre ``x_m, y_m`` and a column a variable."""

from __future__ import annotations

import csv
import io
import math
from array import array
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, listed
from planopt.files.regular import read_text
from planopt.world.raster import Raster, checked_raster

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
    """Read one variable; rows may come in any order, an empty cell or ``nan`` is no value.

    Raises
    ------
    InputError
        The file is missing or no text, a column is missing, a cell is not a number, or the rows
        are not each cell of an even grid once.
    """
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
        raise InputError(f"not a CSV row: {error}", file=path, row=rows.line_num) from error
    return _on_grid(np.array(numbers).reshape(-1, 3), path, variable)


def _on_grid(table: NDArray[np.float64], path: Path, variable: str) -> Raster:
    """The raster whose cells are the rows x, y, value."""
    if not np.isfinite(table[:, :2]).all():
        raise InputError("a cell centre is not finite", file=path)
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
        raise InputError("the row is too short", file=path, key=name, row=row)
    cell = cells[at].strip()
    try:
        return float(cell) if cell else math.nan
    except ValueError:
        raise InputError(f"{cell!r} is not a number", file=path, key=name, row=row) from None
