"""Raster files: what is written is read back, in every format, and bad files are clear errors."""

import builtins
from pathlib import Path

import numpy as np
import pytest

from planopt.errors import InputError, OutputError
from planopt.world.raster import Raster
from planopt.world.raster_files import check_raster_output, read_raster, write_rasters

X, Y = np.array([1.0, 3.0, 5.0]), np.array([-4.0, -1.5])
MEAN = Raster(
    X, Y, np.array([[-61.25, np.nan, -70.0], [-80.5, -90.125, 1e-7]]), "received power", "dBm"
)
CHANCE = Raster(X, Y, np.arange(6.0).reshape(2, 3) / 7, "probability", "1")
ENDINGS = [".csv", ".npz", ".nc", ".tif", ".TIFF", ".NPZ"]


def write(path: Path) -> Path:
    """Both rasters in one file."""
    if path.suffix.lower() in (".tif", ".tiff"):
        pytest.importorskip("rasterio")
    write_rasters(path, {"mean_db": MEAN, "connectivity": CHANCE})
    return path


@pytest.mark.parametrize("ending", ENDINGS)
def test_round_trip(tmp_path: Path, ending: str) -> None:
    """Values, NaN, axes and row order survive; only the file itself is left in the folder."""
    path = write(tmp_path / f"map{ending}")
    for name, raster in (("mean_db", MEAN), ("connectivity", CHANCE)):
        found = read_raster(path, name)
        np.testing.assert_allclose(found.values, raster.values, rtol=1e-11)
        np.testing.assert_allclose(found.x_m, X, rtol=1e-12)
        np.testing.assert_allclose(found.y_m, Y, rtol=1e-12)
        meaning = ("", "") if ending == ".csv" else (raster.quantity, raster.unit)
        assert (found.quantity, found.unit) == meaning
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("ending", [".csv", ".npz", ".nc", ".tif"])
def test_a_variable_that_is_not_there(tmp_path: Path, ending: str) -> None:
    """The error names what the file holds."""
    path = write(tmp_path / f"map{ending}")
    with pytest.raises(InputError, match=r"gain.*connectivity"):
        read_raster(path, "gain")


@pytest.mark.parametrize("ending", [".csv", ".npz", ".nc", ".tif"])
def test_missing_and_foreign_files(tmp_path: Path, ending: str) -> None:
    """Each is one error with the file."""
    if ending == ".tif":
        pytest.importorskip("rasterio")
    path = tmp_path / f"map{ending}"
    with pytest.raises(InputError, match="no such file"):
        read_raster(path, "gain")
    for content in (b"", b"CDF\x01\x00\x00\x00\x05\x00", b"\xff\xfe junk", b'"a\n'):
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"map{ending}"):
            read_raster(path, "gain")
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match=f"map{ending}"):
        read_raster(path, "gain")


def test_unknown_endings(tmp_path: Path) -> None:
    """Neither read nor written; the error names the endings."""
    for name in ("map.asc", "map"):
        with pytest.raises(InputError, match=r"\.csv, \.npz, \.nc, \.tif"):
            read_raster(tmp_path / name, "gain")
        with pytest.raises(InputError, match=r"\.csv, \.npz, \.nc, \.tif"):
            write_rasters(tmp_path / name, {"gain": MEAN})
    assert not list(tmp_path.iterdir())


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """GeoTIFF and NetCDF-4 name what to install, before anything is written."""
    real = builtins.__import__

    def refuse(name: str, *rest: object, **more: object) -> object:
        if name in ("rasterio", "h5netcdf"):
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"install planopt\[maps\]"):
        check_raster_output(tmp_path / "map.tif")
    (tmp_path / "map.nc").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(InputError, match=r"install planopt\[maps\]"):
        read_raster(tmp_path / "map.nc", "gain")


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    """An OutputError, and no part of a file."""
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        write_rasters(tmp_path / "file" / "map.csv", {"gain": MEAN})


def test_csv_rows_in_any_order(tmp_path: Path) -> None:
    """Shuffled rows, another column, a byte order mark, spaces and empty cells."""
    path = tmp_path / "map.csv"
    rows = [
        "5,-4,x,-70",
        "1,-1.5,x,-80.5",
        "3,-4,x,",
        "3,-1.5,x, -90",
        "",
        "1,-4,x,-61",
        "5,-1.5,x,1",
    ]
    path.write_text("\n".join(["﻿x_m, y_m,note,gain", *rows]))
    values = read_raster(path, "gain").values
    np.testing.assert_array_equal(values, [[-61, np.nan, -70], [-80.5, -90, 1]])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x_m,gain\n1,2\n", "no column 'y_m'"),
        ("x_m,y_m,gain,gain\n", "two columns 'gain'"),
        ("x_m,y_m,gain\n1,2,3\n1,b,3\n", "line 3, key y_m: 'b' is not a number"),
        ("x_m,y_m,gain\n1,2\n", "line 2, key gain: the row is too short"),
        ("x_m,y_m,gain\n1,2,3\n2,2,3\n1,3,3\n", "3 rows are not each cell of a grid of 2 x 2"),
        ("x_m,y_m,gain\n" + "1,2,3\n" * 4, "4 rows are not each cell"),
        ("x_m,y_m,gain\n1,2,3\n1,,3\n", "centre is not finite"),
        ("x_m,y_m,gain\n1,2,3\n2,2,3\n", "key y: shape"),
        ("x_m,y_m,gain\n", "key x: shape"),
    ],
)
def test_bad_csv(tmp_path: Path, text: str, says: str) -> None:
    """Each fault is named with its line or column."""
    path = tmp_path / "map.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        read_raster(path, "gain")


def netcdf(path: Path, dimensions: tuple[str, str], kind: str = "i2") -> Path:
    """A packed NetCDF-3 variable whose rows descend, as north-up maps have them."""
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        for name, axis in (("y", Y[::-1]), ("x", X)):
            file.createDimension(name, len(axis))
            file.createVariable(name, "d", (name,))[:] = axis
        gain = file.createVariable("gain", kind, dimensions)
        values = np.array([[-9, 2, 3], [4, 5, 6]], dtype=kind)
        gain[:] = values if dimensions == ("y", "x") else values.T
        gain._FillValue = np.array(-9, dtype=kind)
        gain.scale_factor = 0.5
        gain.add_offset = -100.0
    return path


def test_netcdf_packed_and_north_up(tmp_path: Path) -> None:
    """Scale, offset and fill value are honoured; rows are turned to ascend."""
    found = read_raster(netcdf(tmp_path / "map.nc", ("y", "x")), "gain")
    np.testing.assert_array_equal(found.y_m, Y)
    np.testing.assert_array_equal(found.values, [[-98, -97.5, -97], [np.nan, -99, -98.5]])


def test_netcdf_on_other_dimensions(tmp_path: Path) -> None:
    """x, y instead of y, x is refused, as is a coordinate of text."""
    with pytest.raises(InputError, match="key gain: its dimensions are"):
        read_raster(netcdf(tmp_path / "map.nc", ("x", "y")), "gain")
    with pytest.raises(InputError, match=r"not a NetCDF|not numeric"):
        read_raster(netcdf(tmp_path / "text.nc", ("y", "x"), "c"), "gain")


def test_netcdf4(tmp_path: Path) -> None:
    """Packed NetCDF-4 through h5netcdf agrees with NetCDF-3; text and damage are errors."""
    h5netcdf = pytest.importorskip("h5netcdf")
    path = tmp_path / "map.nc"
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"y": 2, "x": 3}
        file.create_variable("y", ("y",), float)[:] = Y[::-1]
        file.create_variable("x", ("x",), float)[:] = X
        packed = np.array([[-9, 2, 3], [4, 5, 6]], dtype="i2")
        gain = file.create_variable("gain", ("y", "x"), "i2", fillvalue=-9)
        gain[:] = packed
        gain.attrs["scale_factor"] = 0.5
        gain.attrs["add_offset"] = -100.0
        file.create_variable("note", ("y", "x"), data=np.full((2, 3), b"a"))
    found = read_raster(path, "gain")
    same = read_raster(netcdf(tmp_path / "classic.nc", ("y", "x")), "gain")
    np.testing.assert_array_equal(found.values, same.values)
    np.testing.assert_array_equal(found.y_m, same.y_m)
    with pytest.raises(InputError, match=r"key note: .* is not numeric"):
        read_raster(path, "note")
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="not a NetCDF file"):
        read_raster(path, "gain")


def geotiff(path: Path, **options: object) -> Path:
    """One band of ones."""
    rasterio = pytest.importorskip("rasterio")
    shape = {"width": 3, "height": 2, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", driver="GTiff", **(shape | options)) as file:
        file.write(np.arange(6, dtype=np.float32).reshape(2, 3), 1)
    return path


def test_geotiff_of_others(tmp_path: Path) -> None:
    """One band without a description is any variable; its first row is in the north."""
    affine = pytest.importorskip("rasterio").Affine
    north_up = affine(2.0, 0.0, 100.0, 0.0, -5.0, 50.0)
    found = read_raster(geotiff(tmp_path / "a.tif", transform=north_up, nodata=4), "gain")
    np.testing.assert_array_equal(found.x_m, [101, 103, 105])
    np.testing.assert_array_equal(found.y_m, [42.5, 47.5])
    np.testing.assert_array_equal(found.values, [[3, np.nan, 5], [0, 1, 2]])
    south_up = affine(2.0, 0.0, 100.0, 0.0, 5.0, 40.0)
    found = read_raster(geotiff(tmp_path / "b.tif", transform=south_up), "gain")
    np.testing.assert_array_equal(found.y_m, [42.5, 47.5])
    np.testing.assert_array_equal(found.values, [[0, 1, 2], [3, 4, 5]])


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_geotiff_that_is_no_map_in_metres(tmp_path: Path) -> None:
    """Degrees, a rotation and no coordinates at all are refused."""
    affine = pytest.importorskip("rasterio").Affine
    degrees = affine(0.01, 0.0, 11.0, 0.0, -0.01, 48.0)
    with pytest.raises(InputError, match="degrees"):
        read_raster(geotiff(tmp_path / "a.tif", transform=degrees, crs="EPSG:4326"), "gain")
    turned = affine(1.0, 0.5, 0.0, -0.5, 1.0, 0.0)
    for name, options in (("b.tif", {"transform": turned}), ("c.tif", {})):
        with pytest.raises(InputError, match="rotated or has no coordinates"):
            read_raster(geotiff(tmp_path / name, **options), "gain")


def sionna(path: Path, turned: float = 0.0, **arrays: np.ndarray) -> Path:
    """Two transmitters over 2 x 3 cells, as Sionna RT shapes its radio maps."""
    east, north = np.meshgrid(X, Y)
    centres = np.stack([east + turned * north, north, np.full((2, 3), 1.5)], axis=-1)
    gain = np.array([np.full((2, 3), 1e-9), [[1e-8, 0.0, 1e-12], [1.0, 0.1, 0.01]]])
    content = {"path_gain": gain, "cell_centers": centres} | arrays
    np.savez(path, **{name: array.astype(np.float32) for name, array in content.items()})
    return path


def test_sionna_map(tmp_path: Path) -> None:
    """Linear gains become dB, zero becomes NaN, the transmitter is chosen by its number."""
    path = sionna(tmp_path / "map.npz")
    found = read_raster(path, "path_gain[1]")
    np.testing.assert_allclose(found.values, [[-80, np.nan, -120], [0, -10, -20]], atol=1e-5)
    np.testing.assert_array_equal(found.x_m, X)
    np.testing.assert_array_equal(found.y_m, Y)
    np.testing.assert_allclose(read_raster(path, "path_gain[0]").values, -90.0, atol=1e-5)
    for gain in (np.full((2, 3), 0.1), np.full((1, 2, 3), 0.1)):
        one = sionna(tmp_path / "one.npz", path_gain=gain)
        np.testing.assert_allclose(read_raster(one, "path_gain").values, -10.0, atol=1e-5)


@pytest.mark.parametrize(
    ("arrays", "variable", "says"),
    [
        ({}, "path_gain", "there are 2 transmitters"),
        ({}, "path_gain[2]", "no transmitter 2"),
        ({}, "rss", "no 'rss'"),
        ({"turned": 0.1}, "path_gain[0]", "turned"),
        ({"path_gain": np.full((2, 3), -1.0)}, "path_gain", "negative"),
        ({"path_gain": np.ones((3, 2))}, "path_gain", "not of a planar map"),
        ({"path_gain": np.ones((0, 3)), "cell_centers": np.ones((0, 3, 3))}, "path_gain", "cells"),
    ],
)
def test_bad_sionna_map(tmp_path: Path, arrays: dict, variable: str, says: str) -> None:
    """Each fault is named."""
    with pytest.raises(InputError, match=says):
        read_raster(sionna(tmp_path / "map.npz", **arrays), variable)
