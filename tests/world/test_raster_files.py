"""Maps on a grid: looked up, read and written in every format, and bad files."""

import builtins
import contextlib
import gc
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from refusals import refused
from scipy.io import netcdf_file

from planopt import InputError, Workspace
from planopt.world import (
    Raster,
    check_raster_output,
    clearance_m,
    index_obstacles,
    nearest_cells,
    read_raster,
    write_rasters,
)
from planopt.world.geodesy import east_north_m, longitude_latitude_deg

GRID_X = np.array([1.0, 3.0, 5.0])
GRID_Y = np.array([-4.0, -1.0])
GRID = Raster(GRID_X, GRID_Y, np.arange(6.0).reshape(2, 3))


def saved(folder: Path, **arrays: NDArray[np.generic]) -> Path:
    """An npz with good axes unless others are given."""
    path = folder / "map.npz"
    np.savez(path, **{"x": GRID_X, "y": GRID_Y, "gain": np.arange(6).reshape(2, 3)} | arrays)
    return path


def test_munich_map(munich: Workspace) -> None:
    """The map's own building mask agrees with the footprints: axes and rows are not swapped."""
    file = Path(__file__).parents[2] / "problems" / "data" / "munich_mast45m.npz"
    gain = read_raster(file, "path_gain_db")
    building = read_raster(file, "building")
    assert gain.values.shape == (400, 400)
    assert gain.cell_m == (2.0, 2.0)
    positions = np.random.default_rng(1).uniform(-400, 400, (2000, 2))
    covered = building.values[nearest_cells(building, positions)] == 1
    inside = clearance_m(index_obstacles(munich), positions) == 0
    assert (covered == inside).mean() > 0.95


@pytest.mark.parametrize(
    "arrays",
    [
        {"gain": np.zeros((3, 2))},
        {"x": np.array([1.0, 3.0, 6.0])},
        {"y": np.array([1.0, -3.0])},
        {"y": np.array([1.0, np.nan])},
        {"y": np.array([1.0, np.inf])},
        {"y": np.array([1.0])},
        {"y": np.zeros((2, 2))},
        {"gain": np.full((2, 3), "a")},
        {"gain": np.full((2, 3), None)},
    ],
)
def test_bad_contents(tmp_path: Path, arrays: dict[str, NDArray[np.generic]]) -> None:
    """Arrays that are no map are errors with file and key; nothing is unpickled."""
    path = saved(tmp_path, **arrays)
    with refused():
        read_raster(path, "gain")


@settings(deadline=None)
@given(st.floats(0.0, 6.0), st.floats(-5.5, 0.5))
def test_nearest_cell_is_nearest(x: float, y: float) -> None:
    """No other cell centre is nearer, by brute force over all of them."""
    iy, ix = nearest_cells(GRID, np.array([[x, y]]))
    centres = np.hypot(GRID_X[None, :] - x, GRID_Y[:, None] - y)
    assert centres[iy[0], ix[0]] <= centres.min() + 1e-12


def test_cells_are_clamped_and_rows_ascend() -> None:
    """Up to one cell outside counts as the cell at the border; ties go up."""
    positions = np.array([[-1.9, -8.4], [7.9, 3.4], [3.0, -1.0], [2.0, -2.5]])
    iy, ix = nearest_cells(GRID, positions)
    np.testing.assert_array_equal(iy, [0, 1, 1, 1])
    np.testing.assert_array_equal(ix, [0, 2, 1, 1])


@pytest.mark.parametrize("bad", [(-2.1, -2), (8.1, -2), (3, -8.6), (3, 3.6), (np.nan, -2)])
def test_places_off_the_map_are_refused(bad: tuple[float, float]) -> None:
    """Farther than one cell outside, and NaN, are errors that say which place."""
    with refused():
        nearest_cells(GRID, np.array([[3.0, -2.0], bad]))


X, Y = np.array([1.0, 3.0, 5.0]), np.array([-4.0, -1.5])

MEAN = Raster(
    X, Y, np.array([[-61.25, np.nan, -70.0], [-80.5, -90.125, 1e-7]]), "received power", "dBm"
)

CHANCE = Raster(X, Y, np.arange(6.0).reshape(2, 3) / 7, "probability", "1")
ENDINGS = [".csv", ".npz", ".nc", ".tif", ".TIFF", ".NPZ"]


def write(path: Path) -> Path:
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


ORIGIN = (48.1374, 11.5755, 25.0)


def degrees_of(raster: Raster) -> np.ndarray:
    """Longitude and latitude of each cell; (ny, nx, 2)."""
    x, y = np.meshgrid(raster.x_m, raster.y_m)
    found = longitude_latitude_deg(np.stack([x.ravel(), y.ravel()], axis=1), ORIGIN)
    return found.reshape(*x.shape, 2)


def test_a_geotiff_lies_where_its_cells_are(tmp_path: Path) -> None:
    """Read by rasterio, and converted to degrees by PROJ."""
    rasterio = pytest.importorskip("rasterio")
    warp = pytest.importorskip("rasterio.warp")
    write_rasters(tmp_path / "map.tif", {"mean_db": MEAN}, ORIGIN)
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.units == (MEAN.unit,)
        rows, columns = np.indices(MEAN.values.shape)
        x, y = rasterio.transform.xy(file.transform, rows.ravel(), columns.ravel())
        found = np.stack(warp.transform(file.crs, "EPSG:4326", x, y), axis=1)
        np.testing.assert_array_equal(file.read(1), MEAN.values[::-1])
    expected = degrees_of(MEAN)[::-1].reshape(-1, 2)
    np.testing.assert_allclose(found, expected, atol=1e-8)
    again = read_raster(tmp_path / "map.tif", "mean_db")
    np.testing.assert_allclose(again.values, MEAN.values)
    np.testing.assert_allclose(again.x_m, MEAN.x_m, atol=1e-6)
    np.testing.assert_allclose(again.y_m, MEAN.y_m, atol=1e-6)


@pytest.mark.parametrize("ending", ["nc", "csv", "npz"])
def test_degrees_of_each_cell(ending: str, tmp_path: Path) -> None:
    """Beside the map, which is read as before."""
    path = tmp_path / f"map.{ending}"
    write_rasters(path, {"mean_db": MEAN}, ORIGIN)
    np.testing.assert_allclose(read_raster(path, "mean_db").values, MEAN.values)
    if ending == "npz":
        np.testing.assert_array_equal(np.load(path)["origin_deg"], ORIGIN)
    elif ending == "csv":
        table = np.genfromtxt(path, delimiter=",", names=True)
        found = np.stack([table["longitude_deg"], table["latitude_deg"]], axis=1)
        np.testing.assert_allclose(found, degrees_of(MEAN).reshape(-1, 2), atol=1e-9)
    else:
        xarray = pytest.importorskip("xarray")
        with xarray.open_dataset(path, engine="scipy") as data:
            assert data.mean_db.attrs["units"] == MEAN.unit
            for number, name in enumerate(("longitude", "latitude")):
                found = data.mean_db.coords[name]
                assert found.attrs["standard_name"] == name
                np.testing.assert_allclose(found.values, degrees_of(MEAN)[..., number])


def test_the_grid_mapping_of_netcdf(tmp_path: Path) -> None:
    """PROJ reads the attributes of CF and agrees with the degrees of each cell; so does planopt."""
    crs = pytest.importorskip("pyproj").CRS
    xarray = pytest.importorskip("xarray")
    from pyproj import Transformer

    path, x = tmp_path / "map.nc", 10.0 * np.arange(30.0)
    plane = Raster(x, x, x + 2.0 * x[:, None], "received power", "dBm")
    write_rasters(path, {"mean_db": plane}, ORIGIN[:2])
    with xarray.open_dataset(path, engine="scipy") as data:
        attributes = data[data.mean_db.attrs["grid_mapping"]].attrs
        degrees = np.stack([data.longitude.values, data.latitude.values])
    places = np.meshgrid(x, x)
    for system in (crs.from_wkt(attributes.pop("crs_wkt")), crs.from_cf(attributes)):
        found = Transformer.from_crs(system, 4326, always_xy=True).transform(*places)
        np.testing.assert_allclose(found, degrees, atol=1e-9)
    np.testing.assert_array_equal(read_raster(path, "mean_db").values, plane.values)
    longitude, latitude = longitude_latitude_deg(np.array([[20.0, 50.0]]), ORIGIN[:2])[0]
    moved = read_raster(path, "mean_db", (latitude, longitude))
    inner = np.isfinite(moved.values)
    expected = moved.x_m + 20.0 + 2.0 * (moved.y_m[:, None] + 50.0)
    assert inner.mean() > 0.9
    np.testing.assert_allclose(moved.values[inner], expected[inner], atol=0.01)
    with refused():
        read_raster(netcdf(tmp_path / "plain.nc", ("y", "x")), "gain", ORIGIN)


@pytest.mark.parametrize("ending", [".csv", ".npz", ".nc", ".tif"])
def test_missing_and_foreign_files(tmp_path: Path, ending: str) -> None:
    path = write(tmp_path / f"map{ending}")
    for _ in range(2):
        with refused():
            read_raster(path, "gain")
        path.unlink(missing_ok=True)
    for content in (b"", b"CDF\x01\x00\x00\x00\x05\x00", b"\xff\xfe junk", b'"a\n'):
        path.write_bytes(content)
        with refused():
            read_raster(path, "gain")
    path.unlink()
    path.mkdir()
    with refused():
        read_raster(path, "gain")


def test_unknown_endings(tmp_path: Path) -> None:
    """Neither read nor written; the error names the endings."""
    for name in ("map.asc", "map"):
        with refused():
            read_raster(tmp_path / name, "gain")
        with refused():
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
    with refused():
        check_raster_output(tmp_path / "map.tif")
    (tmp_path / "map.nc").write_bytes(b"\x89HDF\r\n\x1a\n")
    with refused():
        read_raster(tmp_path / "map.nc", "gain")


def test_csv_rows_in_any_order(tmp_path: Path) -> None:
    """Shuffled rows, another column, a byte order mark, spaces and empty cells."""
    path = tmp_path / "map.csv"
    rows = "5,-4,x,-70 1,-1.5,x,-80.5 3,-4,x, 3,-1.5,x,\t-90  1,-4,x,-61 5,-1.5,x,1".split(" ")
    path.write_text("\n".join(["﻿x_m, y_m,note,gain", *rows]))
    values = read_raster(path, "gain").values
    np.testing.assert_array_equal(values, [[-61, np.nan, -70], [-80.5, -90, 1]])


@pytest.mark.parametrize(
    "text",
    [
        "x_m,gain\n1,2\n",
        "x_m,y_m,gain,gain\n",
        "x_m,y_m,gain\n1,2,3\n1,b,3\n",
        "x_m,y_m,gain\n1,2\n",
        "x_m,y_m,gain\n1,2,3\n2,2,3\n1,3,3\n",
        "x_m,y_m,gain\n" + "1,2,3\n" * 4,
        "x_m,y_m,gain\n1,2,3\n1,,3\n",
        "x_m,y_m,gain\n1,2,3\n2,2,3\n",
        "x_m,y_m,gain\n",
    ],
)
def test_bad_csv(tmp_path: Path, text: str) -> None:
    """Each fault is named with its line or column."""
    path = tmp_path / "map.csv"
    path.write_text(text)
    with refused():
        read_raster(path, "gain")


def netcdf(path: Path, dimensions: tuple[str, str], kind: str = "i2") -> Path:
    """A packed NetCDF-3 variable whose rows descend, as north-up maps have them."""
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
    """Scale, offset and fill value are honoured; other dimensions and text are refused."""
    found = read_raster(netcdf(tmp_path / "map.nc", ("y", "x")), "gain")
    np.testing.assert_array_equal(found.y_m, Y)
    np.testing.assert_array_equal(found.values, [[-98, -97.5, -97], [np.nan, -99, -98.5]])
    with refused():
        read_raster(netcdf(tmp_path / "map.nc", ("x", "y")), "gain")
    with refused():
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
    with refused():
        read_raster(path, "note")
    path.write_bytes(path.read_bytes()[:100])
    with refused():
        read_raster(path, "gain")


def geotiff(path: Path, **options: object) -> Path:
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
    """Degrees without an origin, a rotation and no coordinates at all are refused."""
    affine = pytest.importorskip("rasterio").Affine
    degrees = affine(0.01, 0.0, 11.0, 0.0, -0.01, 48.0)
    with refused():
        read_raster(geotiff(tmp_path / "a.tif", transform=degrees, crs="EPSG:4326"), "gain")
    turned = affine(1.0, 0.5, 0.0, -0.5, 1.0, 0.0)
    for name, options in (("b.tif", {"transform": turned}), ("c.tif", {})):
        with refused():
            read_raster(geotiff(tmp_path / name, **options), "gain")


@pytest.mark.parametrize("system", ["EPSG:4326", "EPSG:32632", "EPSG:3857"])
@pytest.mark.parametrize(("origin", "turn"), [(ORIGIN[:2], 0.0), (ORIGIN, 0.0), (ORIGIN, 25.0)])
def test_geotiff_in_another_reference_system(
    system: str, origin: tuple[float, ...], turn: float, tmp_path: Path
) -> None:
    """With an origin, each cell has the value of its place on the earth, even of a turned map."""
    rasterio = pytest.importorskip("rasterio")
    warp = pytest.importorskip("rasterio.warp")
    centre = warp.transform("EPSG:4326", system, [ORIGIN[1]], [ORIGIN[0]])
    side = 1e-4 if system == "EPSG:4326" else 10.0
    affine = rasterio.Affine
    along, across = side * np.cos(np.radians(turn)), side * np.sin(np.radians(turn))
    west = centre[0][0] - 20.0 * (along + across)
    north = centre[1][0] + 20.0 * (along - across)
    transform = affine(along, across, west, across, -along, north)
    options = {"transform": transform, "crs": system}
    options |= {"driver": "GTiff", "width": 40, "height": 40, "count": 1, "dtype": "float64"}
    with rasterio.open(tmp_path / "a.tif", "w", **options) as file:
        row, column = np.indices((40, 40))
        x, y = rasterio.transform.xy(file.transform, row.ravel(), column.ravel())
        longitude, latitude = warp.transform(system, "EPSG:4326", x, y)
        east = east_north_m(np.array(longitude), np.array(latitude), origin)
        file.write(east.sum(axis=1).reshape(40, 40), 1)
    found = read_raster(tmp_path / "a.tif", "power", origin)
    x, y = np.meshgrid(found.x_m, found.y_m)
    known = np.isfinite(found.values)
    assert known.mean() > (0.9 if len(origin) == 2 else 0.5)
    inner = np.hypot(x, y) < 100.0
    assert known[inner].all()
    np.testing.assert_allclose(found.values[inner], (x + y)[inner], atol=0.2)
    for name, place in (("a.tif", (10.0, 11.0)), ("b.tif", origin)):
        geotiff(tmp_path / "b.tif", transform=affine(2.0, 0.0, 0.0, 0.0, -2.0, 0.0))
        with refused():
            read_raster(tmp_path / name, "power", place)


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
    ("arrays", "variable"),
    [
        ({}, "path_gain"),
        ({}, "path_gain[2]"),
        ({}, "rss"),
        ({"turned": 0.1}, "path_gain[0]"),
        ({"path_gain": np.full((2, 3), -1.0)}, "path_gain"),
        ({"path_gain": np.ones((3, 2))}, "path_gain"),
        ({"path_gain": np.ones((0, 3)), "cell_centers": np.ones((0, 3, 3))}, "path_gain"),
    ],
)
def test_bad_sionna_map(tmp_path: Path, arrays: dict, variable: str) -> None:
    with refused():
        read_raster(sionna(tmp_path / "map.npz", **arrays), variable)


RASTER = Raster(np.arange(5.0), np.arange(4.0), np.arange(20.0).reshape(4, 5))


def test_sidecars_of_a_tif_are_not_read(tmp_path: Path) -> None:
    """GDAL would take band names and values from neighbours of the file."""
    pytest.importorskip("rasterio")
    path = tmp_path / "map.tif"
    write_rasters(path, {"gain": RASTER})
    (tmp_path / "map.tif.aux.xml").write_text(
        "<PAMDataset><GeoTransform>0,9,0,0,0,-9</GeoTransform><PAMRasterBand band='1'>"
        "<Description>other</Description></PAMRasterBand></PAMDataset>"
    )
    (tmp_path / "map.tif.msk").write_bytes(path.read_bytes())
    found = read_raster(path, "gain")
    np.testing.assert_array_equal(found.values, RASTER.values)
    np.testing.assert_allclose(found.x_m, RASTER.x_m)


@pytest.mark.parametrize(("width", "height", "block"), [(60_000, 60_000, 256), (512, 512, 8192)])
def test_a_tif_that_declares_more_than_it_holds(
    width: int, height: int, block: int, tmp_path: Path
) -> None:
    """A sparse file of a few kilobytes; large blocks are allocated whole."""
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(
        tmp_path / "map.tif",
        "w",
        driver="GTiff",
        width=width,
        height=height,
        count=1,
        dtype="float64",
        tiled=True,
        blockxsize=block,
        blockysize=block,
        sparse_ok=True,
        transform=rasterio.Affine(1.0, 0.0, 9.0, 0.0, -1.0, 0.0),
    ):
        pass
    with refused():
        read_raster(tmp_path / "map.tif", "gain")


def test_a_tif_whose_faults_are_no_text(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """GDAL's message quotes the file, and rasterio cannot decode it: Python would print that."""
    pytest.importorskip("rasterio")
    path = tmp_path / "map.tif"
    write_rasters(path, {"gain": RASTER})
    path.write_bytes(path.read_bytes().replace(b"<Item ", b"<It\x80m "))
    with contextlib.suppress(InputError):
        read_raster(path, "gain")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "name", ["fp", "variables", "use_mmap", "close", "flush", "mode", "dimensions", "_recs"]
)
def test_netcdf_3_attributes_named_like_parts_of_the_reader(name: str, tmp_path: Path) -> None:
    """SciPy sets them on its own object: an error of ours or the values, and nothing printed."""
    path = tmp_path / "map.nc"
    with netcdf_file(path, "w") as file:
        for axis, values in (("y", RASTER.y_m), ("x", RASTER.x_m)):
            file.createDimension(axis, len(values))
            file.createVariable(axis, "d", (axis,))[:] = values
        file.createVariable("gain", "d", ("y", "x"))[:] = RASTER.values
        file._attributes[name] = b"w"
    with contextlib.suppress(InputError):
        np.testing.assert_array_equal(read_raster(path, "gain").values, RASTER.values)
    gc.collect()


def test_netcdf_3_whose_variables_overlap(tmp_path: Path) -> None:
    """Many variables that each declare most of the file are refused before they are all read."""
    path = tmp_path / "map.nc"
    size = 4_000_000
    header = b"CDF\x01" + struct.pack(">I", 0) + struct.pack(">II", 10, 1)
    header += struct.pack(">I", 1) + b"x\0\0\0" + struct.pack(">I", size) + bytes(8)
    header += struct.pack(">II", 11, 5_000)
    for number in range(5_000):
        header += struct.pack(">I4sII", 4, b"%04d" % number, 1, 0) + bytes(8)
        header += struct.pack(">III", 1, size, 100)
    path.write_bytes(header + bytes(size))
    with refused():
        read_raster(path, "gain")


def hdf5(path: Path, **extra: object) -> Path:
    """A NetCDF-4 file with the axes and whatever `extra` makes of the variable."""
    h5netcdf = pytest.importorskip("h5netcdf")
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"y": 4, "x": 5}
        file.create_variable("y", ("y",), data=RASTER.y_m)
        file.create_variable("x", ("x",), data=RASTER.x_m)
        file.create_variable("gain", ("y", "x"), data=RASTER.values, **extra)
    return path


def test_a_netcdf_4_that_declares_more_than_it_holds(tmp_path: Path) -> None:
    """A dataset that was never written takes no room in the file."""
    h5py = pytest.importorskip("h5py")
    path = hdf5(tmp_path / "map.nc")
    with h5py.File(path, "a") as file:
        del file["gain"]
        gain = file.create_dataset("gain", (10**5, 10**5), "f8", chunks=(100, 100))
        gain.dims[0].attach_scale(file["y"])
        gain.dims[1].attach_scale(file["x"])
    assert path.stat().st_size < 100_000
    with refused():
        read_raster(path, "gain")


@pytest.mark.parametrize("kind", ["link", "storage", "virtual"])
def test_a_netcdf_4_that_reads_other_files(kind: str, tmp_path: Path) -> None:
    """HDF5 can take content from elsewhere by link, storage and virtual layout."""
    h5py = pytest.importorskip("h5py")
    hdf5(tmp_path / "other.nc")
    (tmp_path / "secret.txt").write_bytes(b"s" * 160)
    path = hdf5(tmp_path / "map.nc")
    with h5py.File(path, "a") as file:
        del file["gain"]
        if kind == "link":
            file["gain"] = h5py.ExternalLink("other.nc", "/gain")
        elif kind == "storage":
            file.create_dataset("gain", (4, 5), "f8", external=[("secret.txt", 0, 160)])
        else:
            layout = h5py.VirtualLayout((4, 5), "f8")
            layout[:] = h5py.VirtualSource(tmp_path / "other.nc", "gain", (4, 5))
            file.create_virtual_dataset("gain", layout)
    with refused():
        read_raster(path, "gain")


@pytest.mark.parametrize("ending", [".csv", ".npz", ".nc", ".tif"])
@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no devices")
def test_a_map_that_is_a_device_or_a_pipe(ending: str, tmp_path: Path) -> None:
    if ending == ".tif":
        pytest.importorskip("rasterio")
    (tmp_path / f"zero{ending}").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / f"pipe{ending}")
    for name in ("zero", "pipe"):
        with refused():
            read_raster(tmp_path / f"{name}{ending}", "gain")


@pytest.mark.parametrize("ending", [".csv", ".npz", ".nc", ".tif"])
def test_values_that_are_infinite(ending: str, tmp_path: Path) -> None:
    """The decibels of nothing are no value; plus infinity is a fault with its place."""
    if ending == ".tif":
        pytest.importorskip("rasterio")
    values = RASTER.values.copy()
    values[1, 2] = -np.inf
    path = tmp_path / f"map{ending}"
    write_rasters(path, {"gain": Raster(RASTER.x_m, RASTER.y_m, values)})
    found = read_raster(path, "gain").values
    assert np.isnan(found[1, 2]) and np.isnan(found).sum() == 1
    values[1, 2] = np.inf
    write_rasters(path, {"gain": Raster(RASTER.x_m, RASTER.y_m, values)})
    with refused():
        read_raster(path, "gain")
