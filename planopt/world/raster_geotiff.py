# pyright: basic
"""Rasters as GeoTIFF, a band for each variable; the boundary to rasterio, which is an extra.

GeoTIFF has its first row in the north, planopt at the smallest y. Coordinates are metres of a
local plane: no reference system is written, and one in degrees is refused.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import numpy as np

from planopt.errors import InputError
from planopt.world.raster import Raster, checked_raster


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


def write_geotiff(path: Path, rasters: Mapping[str, Raster], units: Mapping[str, str]) -> None:
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
        file.units = tuple(units[name] for name in rasters)
        for band, raster in enumerate(rasters.values(), start=1):
            file.write(raster.values[::-1], band)


def read_geotiff(path: Path, variable: str) -> Raster:
    """Read the band described as `variable`, or the only band if it has no description.

    Raises
    ------
    InputError
        The file is missing or no GeoTIFF, has no such band, is rotated, or has no coordinates or
        such in degrees.
    """
    rasterio = import_rasterio(path)
    if not path.is_file():
        raise InputError("there is no such file", file=path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                band = _band(file.descriptions, variable, path)
                values = file.read(band, masked=True).astype(np.float64).filled(np.nan)
                transform, system = file.transform, file.crs
    except rasterio.errors.RasterioError as error:
        raise InputError(f"not a GeoTIFF that can be read: {error}", file=path) from error
    if transform.b or transform.d or transform.is_identity:
        raise InputError("the map is rotated or has no coordinates", file=path)
    if system is not None and system.is_geographic:
        raise InputError(
            "the coordinates are degrees", file=path, remedy="project the map to metres"
        )
    rows, columns = values.shape
    x = transform.c + transform.a * (np.arange(columns) + 0.5)
    y = transform.f + transform.e * (np.arange(rows) + 0.5)
    if transform.e < 0:
        y, values = y[::-1], values[::-1]
    return checked_raster(x, y, values, path, variable)


def _band(descriptions: tuple[str | None, ...], variable: str, path: Path) -> int:
    """Number of the band, from 1."""
    if descriptions.count(variable) == 1:
        return descriptions.index(variable) + 1
    if descriptions == (None,):
        return 1
    raise InputError(
        f"the file has no band described as {variable!r}",
        file=path,
        remedy=f"it has {', '.join(str(name) for name in descriptions)}",
    )
