"""Raster files of any format that planopt knows, chosen by the ending of the name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from planopt.errors import InputError
from planopt.files.npz import npz_names
from planopt.files.whole import write_whole
from planopt.world.raster import Raster, read_npz_raster, write_npz
from planopt.world.raster_csv import read_csv, write_csv
from planopt.world.raster_geotiff import import_rasterio, read_geotiff, write_geotiff
from planopt.world.raster_netcdf import read_netcdf, write_netcdf
from planopt.world.sionna_map import CENTRES, read_sionna_map


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
    """Read one variable of a raster file.

    Parameters
    ----------
    path
        CSV, npz (planopt's, or a radio map of Sionna RT), NetCDF or GeoTIFF, by ending.
    variable
        Its name in the file: a column, array, variable or band description.

    Raises
    ------
    InputError
        The ending is not known, or the file cannot be read as such.
    """
    return READERS[raster_ending(path)](path, variable)


def write_rasters(path: Path, rasters: Mapping[str, Raster], units: Mapping[str, str]) -> None:
    """Write rasters of the same axes into one file, whole or not at all.

    Parameters
    ----------
    path
        Ends in one of `READERS`.
    rasters
        By variable name; NaN is no value.
    units
        Of each variable.

    Raises
    ------
    InputError
        The ending is not known, or its format needs an extra that is not installed.
    OutputError
        The file cannot be written.
    """
    check_raster_output(path)
    ending = raster_ending(path)

    def write(temporary: Path) -> None:
        if ending == ".csv":
            write_csv(temporary, rasters)
        elif ending == ".npz":
            write_npz(temporary, rasters)
        elif ending == ".nc":
            write_netcdf(temporary, rasters, units)
        else:
            write_geotiff(temporary, rasters, units)

    write_whole(path, write)


def check_raster_output(path: Path) -> None:
    """Raise what :func:`write_rasters` would raise for the name, before any work is done."""
    if raster_ending(path) in GEOTIFF:
        import_rasterio(path)


def raster_ending(path: Path) -> str:
    """The ending of a raster file, in small letters.

    Raises
    ------
    InputError
        It is not one of `READERS`.
    """
    ending = path.suffix.lower()
    if ending not in READERS:
        raise InputError(
            f"{ending or 'a name without ending'!r} is no format of maps",
            file=path,
            remedy=f"end the name in one of {', '.join(READERS)}",
        )
    return ending
