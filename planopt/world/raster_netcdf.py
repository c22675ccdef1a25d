# pyright: basic
"""Rasters as NetCDF: variables on ``y, x``, written as NetCDF-3, which every reader takes.

The boundary to SciPy's reader and writer, which ship no types, and to h5netcdf, which reads the
newer NetCDF-4 where it is installed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.world.raster import Raster, checked_raster

HDF5_SIGNATURE = b"\x89HDF"
AXES = ("y", "x")


def write_netcdf(path: Path, rasters: Mapping[str, Raster], units: Mapping[str, str]) -> None:
    """Write rasters of the same axes with coordinates and units."""
    from scipy.io import netcdf_file

    first = next(iter(rasters.values()))
    with netcdf_file(path, "w") as file:
        for name, axis in zip(AXES, (first.y_m, first.x_m), strict=True):
            file.createDimension(name, len(axis))
            coordinate = file.createVariable(name, "d", (name,))
            coordinate[:] = axis
            coordinate.units = "m"
            coordinate.axis = name.upper()
        for name, raster in rasters.items():
            variable = file.createVariable(name, "d", AXES)
            variable[:] = raster.values
            variable.units = units[name]


def read_netcdf(path: Path, variable: str) -> Raster:
    """Read one variable on the dimensions ``y, x`` with their coordinates; y may descend.

    Raises
    ------
    InputError
        The file is missing or no NetCDF, is NetCDF-4 and h5netcdf is not installed, or holds no
        such variable on an even grid.
    """
    try:
        with path.open("rb") as file:
            newer = file.read(len(HDF5_SIGNATURE)) == HDF5_SIGNATURE
    except FileNotFoundError as error:
        raise InputError("there is no such file", file=path) from error
    except OSError as error:
        raise InputError(f"cannot be read: {error}", file=path) from error
    y, x, values = _newer(path, variable) if newer else _classic(path, variable)
    if y.ndim == 1 and y.size > 1 and y[0] > y[-1]:
        y, values = y[::-1], values[::-1]
    return checked_raster(x, y, values, path, variable)


def _classic(path: Path, variable: str) -> list[NDArray[np.float64]]:
    """y, x and the variable of a NetCDF-3 file."""
    from scipy.io import netcdf_file

    try:
        with netcdf_file(path, "r", mmap=False, maskandscale=True) as file:
            return _numbers(file.variables, variable, path)
    # SciPy checks little: a damaged file ends in whatever its bytes lead to.
    except (OSError, ValueError, TypeError, KeyError, IndexError, AssertionError) as error:
        raise _not_netcdf(path, error) from error


def _newer(path: Path, variable: str) -> list[NDArray[np.float64]]:
    """y, x and the variable of a NetCDF-4 file."""
    try:
        from h5netcdf import File
    except ImportError as error:
        raise InputError(
            "NetCDF-4 cannot be read without h5netcdf",
            file=path,
            remedy="install planopt[maps], or convert with nccopy -k classic",
        ) from error
    try:
        with File(path, "r") as file:
            return _numbers(file.variables, variable, path)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise _not_netcdf(path, error) from error


def _numbers(variables: Mapping[str, Any], variable: str, path: Path) -> list[NDArray[np.float64]]:
    """Values of y, x and the variable as floats, NaN where they are missing."""
    for name in (*AXES, variable):
        if name not in variables:
            raise InputError(
                f"the file holds no {name!r}", file=path, remedy=f"it holds {sorted(variables)}"
            )
    dimensions = tuple(variables[variable].dimensions)
    if dimensions != AXES:
        raise InputError(
            f"the dimensions are {dimensions}, should be {AXES}", file=path, key=variable
        )
    return [_floats(variables[name], path, name) for name in (*AXES, variable)]


def _floats(variable: Any, path: Path, name: str) -> NDArray[np.float64]:
    values = np.ma.asanyarray(variable[:])
    if values.dtype.kind not in "iuf":
        raise InputError(f"{values.dtype} is not numeric", file=path, key=name)
    floats = values.astype(np.float64)
    # SciPy has masked and scaled already; h5netcdf leaves that to its callers.
    attributes = getattr(variable, "attrs", {})
    if "_FillValue" in attributes:
        floats = np.ma.masked_equal(floats, float(np.squeeze(attributes["_FillValue"])))
    scale, offset = (
        float(np.squeeze(attributes.get(key, neutral)))
        for key, neutral in (("scale_factor", 1.0), ("add_offset", 0.0))
    )
    return np.asarray((scale * floats + offset).filled(np.nan), dtype=np.float64)


def _not_netcdf(path: Path, error: Exception) -> InputError:
    return InputError(f"not a NetCDF file that can be read: {error}", file=path)
