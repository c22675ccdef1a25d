# pyright: basic
"""Rasters as NetCDF: variables on ``y, x``, written as NetCDF-3, which every reader takes.

SciPy reads and writes NetCDF-3; h5netcdf, which is an extra, reads NetCDF-4.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, listed
from planopt.files.reading import foreign_reader, read_bytes, require_array_size
from planopt.world.raster import Raster, checked_raster

HDF5_SIGNATURE = b"\x89HDF"
AXES = ("y", "x")

BYTES_PER_READ = 1000
"""Memory that SciPy's reader uses at most for each part of a header."""


def write_netcdf(path: Path, rasters: Mapping[str, Raster]) -> None:
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
            variable.units, variable.long_name = raster.unit, raster.quantity


def read_netcdf(path: Path, variable: str) -> Raster:
    """Read one variable on the dimensions ``y, x`` with their coordinates; y may descend."""
    content = read_bytes(path)
    read = _read_hdf5 if content.startswith(HDF5_SIGNATURE) else _read_classic
    with foreign_reader(path, "a NetCDF file"):
        (y, x, values), attributes = read(path, content, variable)
    if y.ndim == 1 and y.size > 1 and y[0] > y[-1]:
        y, values = y[::-1], values[::-1]
    quantity, unit = (_text(attributes.get(name)) for name in ("long_name", "units"))
    return replace(checked_raster(x, y, values, path, variable), quantity=quantity, unit=unit)


def _text(value: object) -> str:
    """Return the text of an attribute; nothing of any other kind."""
    text = value.decode(errors="replace") if isinstance(value, bytes) else value
    return text.strip("\0 ") if isinstance(text, str) else ""


_Read = tuple[list[NDArray[np.float64]], Mapping[str, Any]]


class _BoundedBytes(io.BytesIO):
    """The bytes of a file, from which not much more than its size is read in all.

    Variables of a damaged header may overlap, each as large as the file.
    """

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self.left = 2 * len(content) + 10_000 * BYTES_PER_READ

    def read(self, size: int | None = -1) -> bytes:
        found = super().read(size)
        self.left -= len(found) + BYTES_PER_READ
        if self.left < 0:
            raise InputError("declares more than the file holds")
        return found


def _read_classic(path: Path, content: bytes, variable: str) -> _Read:
    """Return y, x and the variable of a NetCDF-3 file, and the variable's attributes."""
    from scipy.io import netcdf_file

    class Reader(netcdf_file):
        """A file that is not closed: attributes from its content may replace its methods."""

        def __del__(self) -> None: ...

    held = Reader(_BoundedBytes(content), "r").variables
    _require_map(path, {name: held[name].dimensions for name in held}, variable)
    found = [_floats(held[name].data, vars(held[name]), path, name) for name in (*AXES, variable)]
    return found, vars(held[variable])


def _read_hdf5(path: Path, content: bytes, variable: str) -> _Read:
    """Return y, x and the variable of a NetCDF-4 file, and the variable's attributes."""
    try:
        import h5netcdf
        import h5py
    except ImportError as error:
        raise InputError(
            "NetCDF-4 cannot be read without h5netcdf",
            file=path,
            remedy="install planopt[maps], or convert with nccopy -k classic",
        ) from error
    with h5py.File(io.BytesIO(content), "r") as opened:
        hdf5: Any = opened
        for name in hdf5:
            if isinstance(hdf5.get(name, getlink=True), h5py.ExternalLink):
                raise InputError("links to another file", file=path, key=name)
            item = hdf5[name]
            if not isinstance(item, h5py.Dataset):
                continue
            if item.external or item.is_virtual:
                raise InputError("takes its values from another file", file=path, key=name)
            require_array_size(path, name, *(item.shape or ()))
            # Chunks are unpacked whole.
            require_array_size(path, name, *(item.chunks or ()))
        with h5netcdf.File(opened, "r") as file:
            held = file.variables
            _require_map(path, {name: held[name].dimensions for name in held}, variable)
            found = [
                _floats(held[name][...], held[name].attrs, path, name) for name in (*AXES, variable)
            ]
            return found, dict(held[variable].attrs)


def _require_map(path: Path, held: Mapping[str, tuple[str, ...]], variable: str) -> None:
    """Refuse a file without the variable on y, x; `held` has the dimensions of each variable."""
    for name in (*AXES, variable):
        if name not in held:
            raise InputError(
                f"the file holds no {name!r}", file=path, remedy=f"it holds {listed(sorted(held))}"
            )
    dimensions = tuple(held[variable])
    if dimensions != AXES:
        raise InputError(
            f"its dimensions are {listed(dimensions)}, should be {listed(AXES)}",
            file=path,
            key=variable,
        )


def _floats(
    values: NDArray[Any], attributes: Mapping[str, Any], path: Path, name: str
) -> NDArray[np.float64]:
    """Return values as floats, scaled by the attributes, NaN where they are missing."""
    if values.dtype.kind not in "iuf":
        raise InputError(f"{values.dtype} is not numeric", file=path, key=name)
    require_array_size(path, name, *values.shape)
    floats = values.astype(np.float64)
    missing = np.zeros(floats.shape, dtype=np.bool_)
    for key in ("_FillValue", "missing_value"):
        if key in attributes:
            missing |= floats == float(np.squeeze(attributes[key]))
    scale = float(np.squeeze(attributes.get("scale_factor", 1.0)))
    offset = float(np.squeeze(attributes.get("add_offset", 0.0)))
    return np.where(missing, np.nan, scale * floats + offset)
