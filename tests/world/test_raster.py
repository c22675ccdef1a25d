from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.world.clearance import clearance_m, index_obstacles
from planopt.world.raster import Raster, nearest_cells
from planopt.world.raster_files import read_raster
from planopt.world.workspace import Workspace

X = np.array([1.0, 3.0, 5.0])
Y = np.array([-4.0, -1.0])
RASTER = Raster(X, Y, np.arange(6.0).reshape(2, 3))


def saved(folder: Path, **arrays: NDArray[np.generic]) -> Path:
    """An npz with good axes unless others are given."""
    path = folder / "map.npz"
    np.savez(path, **{"x": X, "y": Y, "gain": np.arange(6).reshape(2, 3)} | arrays)
    return path


def test_round_trip(tmp_path: Path) -> None:
    """What was saved is read back as floats, row 0 at the smallest y."""
    raster = read_raster(saved(tmp_path, x=X.astype(np.float32)), "gain")
    assert raster.values.dtype == raster.x_m.dtype == np.float64
    np.testing.assert_array_equal(raster.values, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(raster.x_m, X)
    np.testing.assert_array_equal(raster.y_m, Y)
    assert raster.cell_m == (2.0, 3.0)


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
    ("arrays", "says"),
    [
        ({"gain": np.zeros((3, 2))}, r"key gain: shape \(3, 2\) does not fit"),
        ({"x": np.array([1.0, 3.0, 6.0])}, "key x: .*evenly"),
        ({"y": np.array([1.0, -3.0])}, "key y: .*ascending"),
        ({"y": np.array([1.0, np.nan])}, "key y: .*finite"),
        ({"y": np.array([1.0, np.inf])}, "key y: .*finite"),
        ({"y": np.array([1.0])}, r"key y: shape \(1,\)"),
        ({"y": np.zeros((2, 2))}, r"key y: shape \(2, 2\)"),
        ({"gain": np.full((2, 3), "a")}, "key gain: <U1 is not numeric"),
        ({"gain": np.full((2, 3), None)}, "key gain: holds Python objects"),
    ],
)
def test_bad_contents(tmp_path: Path, arrays: dict[str, NDArray[np.generic]], says: str) -> None:
    """Arrays that are no map are errors with file and key; nothing is unpickled."""
    path = saved(tmp_path, **arrays)
    with pytest.raises(InputError, match=says) as caught:
        read_raster(path, "gain")
    assert str(caught.value).startswith(str(path))


def test_missing_variable_lists_what_is_there(tmp_path: Path) -> None:
    """The error names the variables that could have been meant."""
    with pytest.raises(InputError, match=r"no 'loss'.*x, y, gain"):
        read_raster(saved(tmp_path), "loss")


def test_not_an_npz(tmp_path: Path) -> None:
    """A missing, an empty, a cut and a foreign file are errors with the file."""
    with pytest.raises(InputError, match=r"none\.npz: there is no such file"):
        read_raster(tmp_path / "none.npz", "gain")
    whole = saved(tmp_path).read_bytes()
    np.save(tmp_path / "array.npy", X)
    contents = [
        b"",
        b"x,y\n1,2\n",
        whole[:-30],
        b"junk" + whole,
        (tmp_path / "array.npy").read_bytes(),
    ]
    spoilt = bytearray(whole)
    spoilt[150] ^= 255
    for content in [*contents, bytes(spoilt)]:
        path = tmp_path / "bad.npz"
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"bad\.npz.*: (is damaged, or )?(is )?not an npz"):
            read_raster(path, "gain")


@settings(deadline=None)
@given(st.floats(0.0, 6.0), st.floats(-5.5, 0.5))
def test_nearest_cell_is_nearest(x: float, y: float) -> None:
    """No other cell centre is nearer, by brute force over all of them."""
    iy, ix = nearest_cells(RASTER, np.array([[x, y]]))
    centres = np.hypot(X[None, :] - x, Y[:, None] - y)
    assert centres[iy[0], ix[0]] <= centres.min() + 1e-12


def test_cells_are_clamped_and_rows_ascend() -> None:
    """Up to one cell outside counts as the cell at the border; ties go up."""
    positions = np.array([[-1.9, -8.4], [7.9, 3.4], [3.0, -1.0], [2.0, -2.5]])
    iy, ix = nearest_cells(RASTER, positions)
    np.testing.assert_array_equal(iy, [0, 1, 1, 1])
    np.testing.assert_array_equal(ix, [0, 2, 1, 1])


@pytest.mark.parametrize("bad", [(-2.1, -2), (8.1, -2), (3, -8.6), (3, 3.6), (np.nan, -2)])
def test_places_off_the_map_are_refused(bad: tuple[float, float]) -> None:
    """Farther than one cell outside, and NaN, are errors that say which place."""
    with pytest.raises(InputError, match=rf"\({bad[0]:g}, {bad[1]:g}\) is outside the map"):
        nearest_cells(RASTER, np.array([[3.0, -2.0], bad]))


def test_no_positions() -> None:
    """No positions give no cells."""
    iy, ix = nearest_cells(RASTER, np.empty((0, 2)))
    assert iy.size == ix.size == 0
