"""Maps that declare more than they hold, or that read files which nobody named."""

import contextlib
import gc
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from planopt.errors import InputError
from planopt.files.reading import LARGEST_TEXT_BYTES
from planopt.world.raster import Raster
from planopt.world.raster_files import read_raster, write_rasters

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
    with pytest.raises(InputError, match=r"declares .* values, more than the limit"):
        read_raster(tmp_path / "map.tif", "gain")


def test_a_tif_whose_description_is_no_text(tmp_path: Path) -> None:
    """It is refused, not decoded."""
    pytest.importorskip("rasterio")
    path = tmp_path / "map.tif"
    write_rasters(path, {"gain": RASTER})
    path.write_bytes(path.read_bytes().replace(b"gain", b"g\x93in"))
    with pytest.raises(InputError, match=r"map\.tif: is damaged, .*again\)$"):
        read_raster(path, "gain")


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
    with pytest.raises(InputError, match=r"map\.nc: declares more than the file holds"):
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


def test_a_sound_netcdf_4(tmp_path: Path) -> None:
    """What the tests below damage."""
    found = read_raster(hdf5(tmp_path / "map.nc", chunks=(2, 2)), "gain")
    np.testing.assert_array_equal(found.values, RASTER.values)


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
    with pytest.raises(InputError, match=r"map\.nc, key gain: declares 100000 x 100000 values"):
        read_raster(path, "gain")


@pytest.mark.parametrize("kind", ["link", "storage", "virtual"])
def test_a_netcdf_4_that_reads_other_files(kind: str, tmp_path: Path) -> None:
    """HDF5 has three ways to take content from elsewhere."""
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
    with pytest.raises(InputError, match=r"map\.nc, key gain: .* another file"):
        read_raster(path, "gain")


@pytest.mark.parametrize("ending", [".csv", ".npz", ".nc", ".tif"])
@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no devices")
def test_a_map_that_is_a_device_or_a_pipe(ending: str, tmp_path: Path) -> None:
    """Neither is opened."""
    if ending == ".tif":
        pytest.importorskip("rasterio")
    (tmp_path / f"zero{ending}").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / f"pipe{ending}")
    for name in ("zero", "pipe"):
        with pytest.raises(InputError, match="is not a regular file"):
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
    with pytest.raises(InputError, match=r"key gain: is infinite at \(2, 1\) m"):
        read_raster(path, "gain")


def test_a_header_with_thousands_of_columns(tmp_path: Path) -> None:
    """The message shows a few of them."""
    path = tmp_path / "map.csv"
    path.write_text(",".join(f"column_{i}" for i in range(3000)) + "\n")
    with pytest.raises(InputError, match="and 2988 more") as caught:
        read_raster(path, "gain")
    assert len(str(caught.value)) < 600


def test_limit_of_text(tmp_path: Path) -> None:
    """CSV maps have the limit of text files; a sparse file takes no time."""
    path = tmp_path / "map.csv"
    path.touch()
    os.truncate(path, LARGEST_TEXT_BYTES + 1)
    with pytest.raises(InputError, match="more than the limit of 64 MB"):
        read_raster(path, "gain")
