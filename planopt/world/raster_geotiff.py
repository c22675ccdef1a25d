# pyright: basic
"""Rasters as GeoTIFF, a band for each variable; the boundary to rasterio, which is an extra.

GeoTIFF has its first row in the north, planopt at the smallest y. Coordinates are metres of a
local plane: no reference system is written, and one in degrees is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from planopt.errors import InputError, listed
from planopt.files.reading import foreign_reader, read_bytes, require_array_size
from planopt.world.raster import Raster, checked_raster

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of TIFF and BigTIFF files in either byte order."""


def import_rasterio(path: Path) -> ModuleType:
    """Return rasterio; an error that names the extra where it is not installed."""
    try:
        import rasterio
    except ImportError as error:
        raise InputError(
            "GeoTIFF needs rasterio, which is not installed",
            file=path,
            remedy="install planopt[maps], or choose .nc, .npz or .csv",
        ) from error
    return rasterio


def write_geotiff(path: Path, rasters: Mapping[str, Raster]) -> None:
    """Write rasters of the same axes as the bands of one file, compressed."""
    rasterio = import_rasterio(path)
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
        transform=rasterio.Affine(wide, 0.0, west, 0.0, -high, north),
        compress="deflate",
    ) as file:
        file.descriptions = tuple(rasters)
        file.units = tuple(raster.unit for raster in rasters.values())
        for band, raster in enumerate(rasters.values(), start=1):
            file.write(raster.values[::-1], band)
            file.update_tags(band, quantity=raster.quantity)


def read_geotiff(path: Path, variable: str) -> Raster:
    """Read the band described as `variable`, or the only band if it has no description.

    The file alone is read, from memory: no sidecar files, and no other format whatever the
    content says (GDAL's virtual formats read files that nobody named).
    """
    rasterio = import_rasterio(path)
    content = read_bytes(path)
    if content[:4] not in SIGNATURES:
        raise InputError(
            "is not a TIFF file", file=path, remedy="save it as GeoTIFF, NetCDF, NPZ or CSV"
        )
    with (
        foreign_reader(path, "a GeoTIFF"),
        rasterio.Env(GDAL_NUM_THREADS=1),
        rasterio.MemoryFile(content) as memory,
        memory.open(driver="GTiff") as file,
    ):
        require_array_size(path, variable, file.height, file.width)
        for shape in file.block_shapes:
            require_array_size(path, variable, *shape)
        band = _band(file.descriptions, variable, path)
        if np.dtype(file.dtypes[band - 1]).kind not in "iuf":
            raise InputError(
                "is not numeric", file=path, key=variable, remedy="give a band of numbers"
            )
        values = file.read(band, masked=True).astype(np.float64).filled(np.nan)
        quantity, unit = file.tags(band).get("quantity", ""), file.units[band - 1] or ""
        transform, system = file.transform, file.crs
        in_degrees = system is not None and system.is_geographic
    if transform.b or transform.d or transform.is_identity:
        raise InputError(
            "the map is rotated or has no coordinates",
            file=path,
            remedy="resample it to axes x and y in metres",
        )
    if in_degrees:
        raise InputError(
            "the coordinates are degrees", file=path, remedy="project the map to metres"
        )
    rows, columns = values.shape
    with np.errstate(all="ignore"):  # coordinates that are not finite
        x = transform.c + transform.a * (np.arange(columns) + 0.5)
        y = transform.f + transform.e * (np.arange(rows) + 0.5)
    if transform.e < 0:
        y, values = y[::-1], values[::-1]
    return replace(checked_raster(x, y, values, path, variable), quantity=quantity, unit=unit)


def _band(descriptions: tuple[str | None, ...], variable: str, path: Path) -> int:
    """Number of the band, from 1."""
    if descriptions.count(variable) == 1:
        return descriptions.index(variable) + 1
    if descriptions == (None,):
        return 1
    raise InputError(
        f"the file has no band described as {variable!r}",
        file=path,
        remedy=f"it has {listed(str(name) for name in descriptions)}",
    )
