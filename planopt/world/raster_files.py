# pyright: basic
"""Raster files by extension: CSV, npz, Sionna RT radio maps, NetCDF and GeoTIFF.

CSV files have a row per cell with its centre ``x_m, y_m`` and a column per variable; NetCDF files
have variables on dimensions ``y, x`` and are written as NetCDF-3; GeoTIFF has a band per variable
with the row of largest y first. If the origin of the frame is known, a GeoTIFF in another reference
system or a NetCDF file with ``crs_wkt`` is resampled into the frame by bilinear interpolation, and
files are written with their reference system. Sionna RT radio maps are saved by
``savez(file, path_gain=map.path_gain.numpy(), cell_centers=map.cell_centers.numpy())``.
"""

import contextlib
import io
import math
import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.errors import InputError, listed
from planopt.files.reading import (
    csv_rows,
    foreign_reader,
    npz_names,
    read_bytes,
    read_npz,
    require_array_size,
)
from planopt.files.writing import write_whole
from planopt.world.geodesy import (
    EQUATOR_RADIUS_M,
    FARTHEST_M,
    FLATTENING,
    Origin,
    longitude_latitude_deg,
    plane_of,
    turn_deg,
)
from planopt.world.raster import Raster, checked_raster

HDF5_SIGNATURE = b"\x89HDF"
NETCDF_AXES = ("y", "x")
DEGREES, DEGREE_UNITS = ("longitude", "latitude"), ("degrees_east", "degrees_north")

BYTES_PER_READ = 1000
"""Upper bound, in bytes, of the memory that SciPy's reader uses per read of a header."""


def write_netcdf(path: Path, rasters: Mapping[str, Raster], origin_deg: Origin | None) -> None:
    """Write rasters that share axes as NetCDF-3 with coordinates and units."""
    from scipy.io import netcdf_file

    first = next(iter(rasters.values()))
    with netcdf_file(path, "w") as file:
        for name, axis in zip(NETCDF_AXES, (first.y_m, first.x_m), strict=True):
            file.createDimension(name, len(axis))
            coordinate: Any = file.createVariable(name, "d", (name,))
            coordinate[:] = axis
            coordinate.units = "m"
            coordinate.axis = name.upper()
            coordinate.standard_name = f"projection_{name}_coordinate"
        # CF has no grid mapping for turned axes.
        plane = origin_deg is not None and not turn_deg(origin_deg)
        if origin_deg is not None and plane:
            system: Any = file.createVariable("crs", "i", ())
            system.grid_mapping_name = "orthographic"
            system.false_easting = system.false_northing = 0.0
            system.semi_major_axis, system.inverse_flattening = EQUATOR_RADIUS_M, 1.0 / FLATTENING
            system.latitude_of_projection_origin = origin_deg[0]
            system.longitude_of_projection_origin = origin_deg[1]
            with contextlib.suppress(ImportError):
                from rasterio import CRS

                crs = CRS.from_string(plane_of(origin_deg))
                system.crs_wkt = crs.to_wkt(version="WKT2_2019")
        if origin_deg is not None:
            x, y = np.meshgrid(first.x_m, first.y_m)
            degrees = longitude_latitude_deg(np.stack([x.ravel(), y.ravel()], axis=1), origin_deg)
            for name, unit, values in zip(DEGREES, DEGREE_UNITS, degrees.T, strict=True):
                variable: Any = file.createVariable(name, "d", NETCDF_AXES)
                variable[:] = values.reshape(x.shape)
                variable.units, variable.standard_name = unit, name
        for name, raster in rasters.items():
            variable: Any = file.createVariable(name, "d", NETCDF_AXES)
            variable[:] = raster.values
            variable.units, variable.long_name = raster.unit, raster.quantity
            if origin_deg is not None:
                variable.coordinates = " ".join(DEGREES)
            if plane:
                variable.grid_mapping = "crs"


def read_netcdf(path: Path, variable: str, origin_deg: Origin | None = None) -> Raster:
    """Return one variable of a NetCDF file, on dimensions ``y, x`` with coordinates."""
    content = read_bytes(path)
    read = _read_hdf5 if content.startswith(HDF5_SIGNATURE) else _read_classic
    with foreign_reader(path, "a NetCDF file"):
        (y, x, values), attributes, system = read(path, content, variable)
    if y.ndim == 1 and y.size > 1 and y[0] > y[-1]:
        y, values = y[::-1], values[::-1]
    quantity, unit = (_text(attributes.get(name)) for name in ("long_name", "units"))
    found = replace(checked_raster(x, y, values, variable), quantity=quantity, unit=unit)
    if origin_deg is None:
        return found
    rasterio = import_rasterio(path)
    with foreign_reader(path, "a NetCDF file"):
        (wide, high), west = found.cell_m, found.x_m[0] - found.cell_m[0] / 2.0
        placed = rasterio.Affine(wide, 0.0, west, 0.0, -high, found.y_m[-1] + high / 2.0)
        crs = rasterio.CRS.from_wkt(system) if system else None
        values, placed = _in_frame(crs, placed, found.values[::-1], origin_deg, path)
    return _placed(values, placed, variable, quantity, unit)


def _text(value: object) -> str:
    """Return an attribute as text; an empty string if it is not text."""
    text = value.decode(errors="replace") if isinstance(value, bytes) else value
    return text.strip("\0 ") if isinstance(text, str) else ""


_Read = tuple[list[Floats], Mapping[str, Any], str]


class _BoundedBytes(io.BytesIO):
    """In-memory file that limits the total number of bytes read."""

    # In a damaged file, variables may overlap, each as large as the file.

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self.left = 2 * len(content) + 10_000 * BYTES_PER_READ

    def read(self, size: int | None = -1) -> bytes:
        found = super().read(size)
        self.left -= len(found) + BYTES_PER_READ
        if self.left < 0:
            raise InputError("declares more data than the file contains")
        return found


def _read_classic(path: Path, content: bytes, variable: str) -> _Read:
    """Return y, x and `variable` of a NetCDF-3 file, and the variable's attributes and CRS."""
    from scipy.io import netcdf_file

    class Reader(netcdf_file):
        """Reader without a destructor, because attributes of a file may overwrite its methods."""

        def __del__(self) -> None: ...

    held = Reader(_BoundedBytes(content), "r").variables
    _require_map({name: held[name].dimensions for name in held}, variable)
    found = [
        _floats(held[name].data, vars(held[name]), path, name) for name in (*NETCDF_AXES, variable)
    ]
    attributes = vars(held[variable])
    mapping = held.get(_text(attributes.get("grid_mapping")))
    return found, attributes, "" if mapping is None else _text(vars(mapping).get("crs_wkt"))


def _read_hdf5(path: Path, content: bytes, variable: str) -> _Read:
    """Return y, x and `variable` of a NetCDF-4 file, and the variable's attributes and CRS."""
    try:
        import h5netcdf
        import h5py
    except ImportError as error:
        raise InputError(
            "the package h5netcdf, which reads NetCDF-4, is not installed",
            remedy="pip install 'planopt[maps]', or convert the file with nccopy -k classic",
        ) from error
    with h5py.File(io.BytesIO(content), "r") as opened:
        hdf5: Any = opened
        for name in hdf5:
            if isinstance(hdf5.get(name, getlink=True), h5py.ExternalLink):
                raise InputError("is a link to another file, which is not followed", key=name)
            item = hdf5[name]
            if not isinstance(item, h5py.Dataset):
                continue
            if item.external or item.is_virtual:
                raise InputError("is stored in another file, which is not followed", key=name)
            require_array_size(path, name, *(item.shape or ()))
            # HDF5 decompresses whole chunks at once.
            require_array_size(path, name, *(item.chunks or ()))
        with h5netcdf.File(opened, "r") as file:
            held = file.variables
            _require_map({name: held[name].dimensions for name in held}, variable)
            found = [
                _floats(held[name][...], held[name].attrs, path, name)
                for name in (*NETCDF_AXES, variable)
            ]
            attributes = dict(held[variable].attrs)
            mapping = held.get(_text(attributes.get("grid_mapping")))
            return found, attributes, "" if mapping is None else _text(mapping.attrs.get("crs_wkt"))


def _require_map(held: Mapping[str, Sequence[str]], variable: str) -> None:
    """Raise an InputError for a file without `variable`, or with dimensions other than y, x."""
    for name in (*NETCDF_AXES, variable):
        if name not in held:
            raise InputError(
                f"the file has no variable {name!r}", remedy=f"it has {listed(sorted(held))}"
            )
    dimensions = tuple(held[variable])
    if dimensions != NETCDF_AXES:
        raise InputError(
            f"has the dimensions {listed(dimensions)}, should have {listed(NETCDF_AXES)}",
            key=variable,
        )


def _floats(values: NDArray[Any], attributes: Mapping[str, Any], path: Path, name: str) -> Floats:
    """Return values as floats, scaled by their attributes; missing values are NaN."""
    if values.dtype.kind not in "iuf":
        raise InputError(f"has type {values.dtype}", key=name, remedy="give numbers")
    require_array_size(path, name, *values.shape)
    floats = values.astype(np.float64)
    missing = np.zeros(floats.shape, dtype=np.bool_)
    for key in ("_FillValue", "missing_value"):
        if key in attributes:
            missing |= floats == float(np.squeeze(attributes[key]))
    scale = float(np.squeeze(attributes.get("scale_factor", 1.0)))
    offset = float(np.squeeze(attributes.get("add_offset", 0.0)))
    return np.where(missing, np.nan, scale * floats + offset)


SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of TIFF and BigTIFF files in either byte order."""


def import_rasterio(path: Path) -> ModuleType:
    """Return the module rasterio; raise an InputError that names the extra if it is missing."""
    try:
        import rasterio
    except ImportError as error:
        raise InputError(
            "the package rasterio, which reads and writes GeoTIFF, is not installed",
            file=path,
            remedy="pip install 'planopt[maps]', or use .nc, .npz or .csv",
        ) from error
    return rasterio


TURN_TAG = "planopt_turn_rad"
"""Tag of a GeoTIFF with the angle in rad by which its axes are turned in its reference system."""


def write_geotiff(path: Path, rasters: Mapping[str, Raster], origin_deg: Origin | None) -> None:
    """Write rasters that share axes as the bands of one compressed GeoTIFF."""
    rasterio = import_rasterio(path)
    turn, system = 0.0, None
    if origin_deg is not None:
        turn = math.radians(turn_deg(origin_deg))
        system = rasterio.CRS.from_string(plane_of(origin_deg))
    cosine, sine = math.cos(turn), math.sin(turn)
    first = next(iter(rasters.values()))
    wide, high = first.cell_m
    west, north = first.x_m[0] - wide / 2, first.y_m[-1] + high / 2
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=len(first.x_m),
        height=len(first.y_m),
        count=len(rasters),
        dtype="float64",
        nodata=np.nan,
        transform=rasterio.Affine(
            *(cosine * wide, sine * high, cosine * west - sine * north),
            *(sine * wide, -cosine * high, sine * west + cosine * north),
        ),
        crs=system,
        compress="deflate",
    ) as file:
        file.descriptions = tuple(rasters)
        file.units = tuple(raster.unit for raster in rasters.values())
        for band, raster in enumerate(rasters.values(), start=1):
            file.write(raster.values[::-1], band)
            file.update_tags(band, quantity=raster.quantity)
        file.update_tags(**{TURN_TAG: repr(turn)})


def read_geotiff(path: Path, variable: str, origin_deg: Origin | None = None) -> Raster:
    """Return the band described as `variable`, or the only band if it has no description."""
    # GDAL's virtual formats and sidecar files could open further files.
    rasterio = import_rasterio(path)
    content = read_bytes(path)
    if content[:4] not in SIGNATURES:
        raise InputError("is not a TIFF file", remedy="save it as GeoTIFF, NetCDF, NPZ or CSV")
    with (
        foreign_reader(path, "a GeoTIFF"),
        rasterio.Env(GDAL_NUM_THREADS=1),
        rasterio.MemoryFile(content) as memory,
        memory.open(driver="GTiff") as file,
    ):
        require_array_size(path, variable, file.height, file.width)
        for shape in file.block_shapes:
            require_array_size(path, variable, *shape)
        bands: tuple[str | None, ...] = file.descriptions
        if bands != (None,) and bands.count(variable) != 1:
            raise InputError(
                f"the file has no band described as {variable!r}",
                remedy=f"it has {listed(str(name) for name in bands)}",
            )
        band = 1 if bands == (None,) else bands.index(variable) + 1
        if np.dtype(file.dtypes[band - 1]).kind not in "iuf":
            raise InputError("is not numeric", key=variable, remedy="choose a numeric band")
        values = file.read(band, masked=True).astype(np.float64).filled(np.nan)
        quantity, unit = file.tags(band).get("quantity", ""), file.units[band - 1] or ""
        # The axes of the map, which planopt may have turned in the reference system.
        turn = math.degrees(float(file.tags().get(TURN_TAG, 0.0)))
        transform, system = rasterio.Affine.rotation(-turn) * file.transform, file.crs
        in_degrees = system is not None and system.is_geographic
        if origin_deg is not None:
            values, transform = _in_frame(system, file.transform, values, origin_deg, path)
            in_degrees = False
    sheared = max(abs(transform.b), abs(transform.d)) > 1e-9 * abs(transform.a)
    if sheared or transform.is_identity:
        raise InputError(
            "the map is rotated or has no coordinates",
            remedy="give the origin of the frame, origin_deg = [LAT, LON], if the file has a "
            "reference system; else resample it to axis-parallel cells in metres",
        )
    if in_degrees:
        raise InputError(
            "the coordinates are in degrees",
            remedy="give the origin of the frame: origin_deg = [LAT, LON]",
        )
    return _placed(values, transform, variable, quantity, unit)


def _placed(values: Floats, transform: Any, variable: str, quantity: str, unit: str) -> Raster:
    """Return the raster of `values` with cells placed by an axis-parallel transform."""
    rows, columns = values.shape
    with np.errstate(all="ignore"):  # non-finite coordinates
        x = transform.c + transform.a * (np.arange(columns) + 0.5)
        y = transform.f + transform.e * (np.arange(rows) + 0.5)
    if transform.e < 0:
        y, values = y[::-1], values[::-1]
    return replace(checked_raster(x, y, values, variable), quantity=quantity, unit=unit)


def _in_frame(
    system: Any, source: Any, values: Floats, origin_deg: Origin, path: Path
) -> tuple[Floats, Any]:
    """Return a map's values, resampled to cells along a frame's axes, and their transform."""
    from rasterio import Affine, transform, warp

    if system is None:
        raise InputError(
            "the map has no reference system, so that its place is unknown",
            key="origin_deg",
            remedy="leave out origin_deg if the coordinates are metres in the frame",
        )
    (rows, columns), plane = values.shape, plane_of(origin_deg)
    turn = Affine.rotation(turn_deg(origin_deg))
    row, column = np.indices((rows + 1, columns + 1)).reshape(2, -1)
    edge = (row % rows == 0) | (column % columns == 0)
    places = transform.xy(source, row[edge], column[edge], offset="ul")
    x, y = ~turn * np.array(warp.transform(system, plane, *places))
    if not np.isfinite(x).all() or max(np.abs(x).max(), np.abs(y).max()) > FARTHEST_M:
        raise InputError(
            f"the map is more than {FARTHEST_M / 1000.0:.0f} km from the origin",
            key="origin_deg",
            remedy="give the latitude and longitude of (0, 0), close to the map",
        )
    # GDAL smoothes values where it needs fewer cells.
    second, third = columns, -(columns + 1)
    side = min(
        math.hypot(x[second] - x[0], y[second] - y[0]) / columns,
        math.hypot(x[third] - x[0], y[third] - y[0]) / rows,
    )
    width, height = (max(1, math.ceil(float(np.ptp(each)) / side - 1e-6)) for each in (x, y))
    require_array_size(path, "the map in metres", height, width)
    placed = Affine(side, 0.0, x.min(), 0.0, -side, y.max())
    found = np.full((height, width), np.nan)
    warp.reproject(
        values,
        found,
        src_transform=source,
        src_crs=system,
        src_nodata=np.nan,
        dst_transform=turn * placed,
        dst_crs=plane,
        dst_nodata=np.nan,
        resampling=warp.Resampling.bilinear,
        tolerance=0.0,
    )
    return found, placed


AXES = ("x_m", "y_m")

DIGITS = "%.12g"  # Number format: 12 digits resolve a millimetre in any coordinate


def write_csv(path: Path, rasters: Mapping[str, Raster], origin_deg: Origin | None) -> None:
    """Write rasters that share axes as CSV, from the smallest y; missing values are ``nan``."""
    first = next(iter(rasters.values()))
    x, y = np.meshgrid(first.x_m, first.y_m)
    columns = [each.ravel() for each in (x, y, *(raster.values for raster in rasters.values()))]
    header = ",".join((*AXES, *rasters))
    if origin_deg is not None:
        columns += list(longitude_latitude_deg(np.stack(columns[:2], axis=1), origin_deg).T)
        header += ",longitude_deg,latitude_deg"
    table = np.column_stack(columns)
    np.savetxt(path, table, fmt=DIGITS, delimiter=",", header=header, comments="")


def read_csv(path: Path, variable: str) -> Raster:
    """Return one variable of a CSV file with rows in any order; empty or ``nan`` is missing."""
    rows = csv_rows(path)
    nothing: tuple[int, list[str]] = (1, [])
    header = [name.strip() for name in next(rows, nothing)[1]]
    for name in (*AXES, variable):
        if header.count(name) != 1:
            raise InputError(
                f"the file has {'two columns' if name in header else 'no column'} {name!r}",
                key=name,
                remedy=f"its columns are {listed(header)}"
                if header
                else "write a header with columns",
            )
    where = [header.index(name) for name in (*AXES, variable)]
    # An array takes a third of the memory of lists of floats.
    numbers = array("d")
    for line, cells in rows:
        numbers.extend(_number(cells, at, line, header[at]) for at in where)
    table = np.array(numbers).reshape(-1, 3)
    if not np.isfinite(table[:, :2]).all():
        raise InputError(
            "a cell centre is NaN or infinite", remedy="remove rows without coordinates"
        )
    x, ix = np.unique(table[:, 0], return_inverse=True)
    y, iy = np.unique(table[:, 1], return_inverse=True)
    if len(np.unique(iy * x.size + ix)) != len(table) or len(table) != x.size * y.size:
        raise InputError(
            f"the {len(table)} rows should contain each cell of the {y.size} x {x.size} grid "
            "exactly once",
            remedy="write one row for each cell; use nan for missing values",
        )
    values = np.empty((y.size, x.size))
    values[iy, ix] = table[:, 2]
    return checked_raster(x, y, values, variable)


def _number(cells: list[str], at: int, row: int, name: str) -> float:
    if at >= len(cells):
        raise InputError(
            "the row has too few cells",
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
            key=name,
            row=row,
            remedy="write a number, or leave the cell empty for a missing value",
        ) from None


QUANTITIES = "quantities"
"""Name of the npz entry with name, quantity and unit of each variable, as text (k, 3)."""


def write_npz(path: Path, rasters: Mapping[str, Raster], origin_deg: Origin | None) -> None:
    """Write rasters that share axes as an ``npz`` file with entries ``x`` and ``y``."""
    first = next(iter(rasters.values()))
    arrays: dict[str, Any] = {name: raster.values for name, raster in rasters.items()}
    arrays[QUANTITIES] = [(name, each.quantity, each.unit) for name, each in rasters.items()]
    if origin_deg is not None:
        arrays["origin_deg"] = origin_deg
    # Given a path, NumPy would append .npz to an uppercase extension.
    with path.open("wb") as file:
        np.savez_compressed(file, x=first.x_m, y=first.y_m, **arrays)


def read_npz_raster(path: Path, variable: str) -> Raster:
    """Return a variable of an ``npz`` file; with cell centres, the file is a Sionna RT map."""
    if CENTRES in npz_names(path):
        return read_sionna_map(path, variable)
    x, y, values = npz_arrays(path, ("x", "y", variable))
    table = read_npz(path, (QUANTITIES,)).get(QUANTITIES, np.zeros((0, 3), dtype="U1"))
    rows: list[Any] = table.tolist() if table.dtype.kind == "U" and table.ndim == 2 else []
    known: dict[str, list[str]] = {row[0]: row[1:] for row in rows if len(row) == 3}
    quantity, unit = known.get(variable, ("", ""))
    return replace(checked_raster(x, y, values, variable), quantity=quantity, unit=unit)


def npz_arrays(path: Path, names: tuple[str, ...]) -> list[Floats]:
    """Return the named arrays of an npz file as floats."""
    arrays = read_npz(path, names)
    found: list[Floats] = []
    for name in names:
        if name not in arrays:
            raise InputError(
                f"the file has no variable {name!r}", remedy=f"it has {listed(npz_names(path))}"
            )
        if arrays[name].dtype.kind not in "biuf":
            raise InputError(f"has type {arrays[name].dtype}", key=name, remedy="give numbers")
        with np.errstate(all="ignore"):  # overflow from longer floats
            found.append(arrays[name].astype(np.float64))
    return found


CENTRES = "cell_centers"

TURNED_M = 1e-2
"""Tolerance in metres for cell centres off their row or column, as Sionna RT uses float32."""


def read_sionna_map(path: Path, variable: str) -> Raster:
    """Return a linear quantity of a planar Sionna RT radio map, converted to dB."""
    # A text such as path_gain[2] names a transmitter.
    match = re.fullmatch(r"(.+)\[(\d{1,6})\]", variable)
    name, index = (variable, None) if match is None else (match[1], int(match[2]))
    gain, centres = npz_arrays(path, (name, CENTRES))
    if gain.ndim == 3:
        if index is None and len(gain) != 1:
            raise InputError(
                f"has {len(gain)} transmitters, and none is selected",
                key=name,
                remedy=f"write {name}[0] for the first transmitter",
            )
        if (index or 0) >= len(gain):
            raise InputError(
                f"has no transmitter {index}: there are {len(gain)}, counted from 0",
                key=name,
                remedy=f"use an index from 0 to {len(gain) - 1}",
            )
        gain = gain[index or 0]
    if gain.ndim != 2 or centres.shape != (*gain.shape, 3):
        raise InputError(
            f"has shape {gain.shape} and cell centres of shape {centres.shape}, which do not "
            "form a planar map",
            key=name,
        )
    if not gain.size:
        raise InputError("has no cells", key=name)
    x, y = centres[0, :, 0], centres[:, 0, 1]
    with np.errstate(all="ignore"):  # non-finite centres
        off = np.maximum(np.abs(centres[..., 0] - x), np.abs(centres[..., 1] - y[:, None]))
    # Negated comparison, so that NaN centres fail.
    if not (off <= TURNED_M).all():
        raise InputError(
            "is a rotated map: its rows are not parallel to x",
            key=CENTRES,
            remedy="compute the radio map on a plane whose rows are parallel to x",
        )
    if (gain < 0.0).any():
        raise InputError(
            "has a negative value, but linear path gains are positive",
            key=name,
            remedy="give linear path gains, or choose the variable with gains in dB",
        )
    decibels = np.full(gain.shape, np.nan)
    np.log10(gain, out=decibels, where=gain > 0.0)
    return checked_raster(x, y, 10.0 * decibels, variable)


READERS: dict[str, Callable[[Path, str], Raster]] = {
    ".csv": read_csv,
    ".npz": read_npz_raster,
    ".nc": read_netcdf,
    ".tif": read_geotiff,
    ".tiff": read_geotiff,
}
"""Readers of raster files by file extension."""

WRITERS: dict[str, Callable[[Path, Mapping[str, Raster], Origin | None], None]] = {
    ".csv": write_csv,
    ".npz": write_npz,
    ".nc": write_netcdf,
    ".tif": write_geotiff,
    ".tiff": write_geotiff,
}
"""Writers of raster files by file extension."""


def read_raster(path: Path, variable: str, origin_deg: Origin | None = None) -> Raster:
    """Return one variable of a raster file; `origin_deg` needs a file with a reference system."""
    reader = READERS[raster_ending(path)]
    try:
        if origin_deg is None:
            return reader(path, variable)
        if reader not in (read_geotiff, read_netcdf):
            raise InputError(
                "has no reference system, so that its place is unknown",
                key="origin_deg",
                remedy="leave out origin_deg, or give a GeoTIFF",
            )
        return (read_netcdf if reader is read_netcdf else read_geotiff)(path, variable, origin_deg)
    except InputError as error:
        raise error.located(path) from error.__cause__


def write_rasters(
    path: Path, rasters: Mapping[str, Raster], origin_deg: Origin | None = None
) -> None:
    """Write rasters that share axes to one file atomically."""
    check_raster_output(path)
    write = WRITERS[raster_ending(path)]
    write_whole(path, lambda temporary: write(temporary, rasters, origin_deg))


def check_raster_output(path: Path) -> None:
    """Raise the error that :func:`write_rasters` would raise for a path."""
    if WRITERS[raster_ending(path)] is write_geotiff:
        import_rasterio(path)


def raster_ending(path: Path) -> str:
    """Return the lower-case extension of a raster file."""
    ending = path.suffix.lower()
    if ending not in READERS:
        raise InputError(
            f"is not a map file: the ending {ending!r} is unknown",
            file=path,
            remedy=f"use a name that ends in one of {', '.join(READERS)}",
        )
    return ending
