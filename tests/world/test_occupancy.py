"""Occupancy grids: their files by the rules of map_server, and the polygons of closed cells."""

import time
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from PIL import Image
from refusals import refused

from planopt import load
from planopt.problems import OccupancyGrid
from planopt.world import TILE_CELLS, grid_obstacles, occupancy, read_grid, read_obstacles

YAML = """\
image: hall.pgm
resolution: 0.5
origin: [-2.0, 1.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""

SHADES = np.array([[0, 254, 205], [254, 254, 0]], dtype=np.uint8)
"""As SLAM writes them: occupied, free, unknown; the first row is the top."""


def ros_map(folder: Path, text: str = YAML, shades: NDArray[np.uint8] = SHADES) -> Path:
    """A map of ROS: its YAML, and the image that this names."""
    (folder / "hall.yaml").write_text(text)
    Image.fromarray(shades).save(folder / "hall.pgm")
    return folder / "hall.yaml"


def test_trinary(tmp_path: Path) -> None:
    """The three values of a map that SLAM made, the last row of the image at the smallest y."""
    grid = read_grid(ros_map(tmp_path))
    assert grid.occupied.tolist() == [[False, False, True], [True, False, False]]
    assert grid.unknown.tolist() == [[False, False, False], [False, False, True]]
    assert (grid.resolution_m, grid.origin_m) == (0.5, (-2.0, 1.0))


@pytest.mark.parametrize("yaw", [0.3, -2.0, np.pi / 2])
@pytest.mark.parametrize("unknown", ["occupied", "free"])
def test_turned_map(yaw: float, unknown: str, tmp_path: Path) -> None:
    """A position is closed where its cell is; beyond the map it is unknown."""
    generator = np.random.default_rng(0)
    shades = generator.choice(np.array([0, 205, 254], dtype=np.uint8), (40, 45))
    text = YAML.replace("[-2.0, 1.0, 0.0]", f"[-2.0, 1.0, {yaw}]")
    path = ros_map(tmp_path, text, shades)
    grid = read_grid(path)
    x_min, y_min, x_max, y_max = grid.bounds_m
    places = generator.uniform((x_min, y_min), (x_max, y_max), (4000, 2))
    away = places - np.array([-2.0, 1.0])
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    column, row = np.floor(away @ turn / 0.5).astype(int).T
    inside = (0 <= column) & (column < 45) & (0 <= row) & (row < 40)
    grey = shades[::-1][np.clip(row, 0, 39), np.clip(column, 0, 44)]
    closed = np.where(inside, grey == 0, False)
    if unknown == "occupied":
        closed |= np.where(inside, grey == 205, True)
    union = shapely.union_all([each.polygon for each in read_obstacles(path, unknown)])
    found = shapely.contains_xy(union, *places.T)
    assert (found == closed).mean() > 0.999  # Other points are on an edge.
    area = sum(each.polygon.area for each in read_obstacles(path, "free"))
    assert area == pytest.approx(0.25 * (shades == 0).sum())


def reference(shade: int, mode: str, negate: int, occupied: float, free: float) -> str:
    """What Nav2's map_io makes of an opaque pixel, written out for one pixel."""
    if mode == "raw":
        value = shade if 0 <= shade <= 100 else -1
        if value < 0:
            return "unknown"
        level = value / 100
    else:
        level = shade / 255 if negate else 1 - shade / 255
    return "occupied" if level > occupied else "free" if level < free else "unknown"


def test_numbers_as_text(tmp_path: Path) -> None:
    """YAML 1.1 takes 5e-1 for text, ROS for a number."""
    assert read_grid(ros_map(tmp_path, YAML.replace("0.5", "5e-1"))).resolution_m == 0.5


@pytest.mark.parametrize(
    ("mode", "negate"), [("trinary", 0), ("trinary", 1), ("scale", 0), ("scale", 1), ("raw", 0)]
)
@pytest.mark.parametrize(("occupied", "free"), [(0.65, 0.25), (0.65, 0.196), (0.5, 0.5), (1.0, 0)])
def test_every_shade(tmp_path: Path, mode: str, negate: int, occupied: float, free: float) -> None:
    text = f"""
image: hall.pgm
mode: {mode}
resolution: 1
origin: [0, 0, 0]
negate: {negate}
occupied_thresh: {occupied}
free_thresh: {free}
"""
    grid = read_grid(ros_map(tmp_path, text, np.arange(256, dtype=np.uint8)[None]))
    kinds = np.where(grid.occupied, "occupied", np.where(grid.unknown, "unknown", "free"))
    wanted = [reference(shade, mode, negate, occupied, free) for shade in range(256)]
    assert kinds[0].tolist() == wanted


@pytest.mark.parametrize("mode", ["L", "LA", "RGB", "RGBA", "P", "1", "I;16"])
def test_kinds_of_pixels(tmp_path: Path, mode: str) -> None:
    """Black is occupied and white is free in any PNG; what is not opaque is unknown."""
    black_white = Image.fromarray(np.array([[0, 255, 255]], dtype=np.uint8))
    if mode == "I;16":
        image = Image.fromarray(np.array([[0, 65535, 65535]], dtype=np.uint16))
    else:
        image = black_white.convert(mode)
    if mode in ("LA", "RGBA"):
        image.putalpha(Image.fromarray(np.array([[255, 255, 0]], dtype=np.uint8)))
    image.save(tmp_path / "hall.png")
    (tmp_path / "hall.yml").write_text(YAML.replace("hall.pgm", "hall.png"))
    grid = read_grid(tmp_path / "hall.yml")
    assert grid.occupied.tolist() == [[True, False, False]]
    assert grid.unknown.tolist() == [[False, False, mode in ("LA", "RGBA")]]


def test_pgm_of_other_kinds(tmp_path: Path) -> None:
    """Plain text, a comment, another largest value, 16 bits: all are PGM."""
    (tmp_path / "hall.yaml").write_text(YAML)
    for content in (
        b"P2\n# made by hand\n2 1\n255\n0 255\n",
        b"P5\n2 1\n100\n\x00\x64",
        b"P5\n2 1\n65535\n\x00\x00\xff\xff",
    ):
        (tmp_path / "hall.pgm").write_bytes(content)
        assert read_grid(tmp_path / "hall.yaml").occupied.tolist() == [[True, False]]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("origin: [-2.0, 1.0, 0.0]", "origin: [0, 0, 90]"),
        ("origin: [-2.0, 1.0, 0.0]", "origin: [0]"),
        ("origin: [-2.0, 1.0, 0.0]", "origin: [.nan, 0, 0]"),
        ("origin: [-2.0, 1.0, 0.0]", "origin: [1e12, 0, 0]"),
        ("resolution: 0.5", "resolution: 0"),
        ("resolution: 0.5", "resolution: fine"),
        ("resolution: 0.5", "resolution: true"),
        ("resolution: 0.5", "resolution: " + "9" * 400),
        ("resolution: 0.5\n", ""),
        ("negate: 0", "negate: 2"),
        ("negate: 0", "negate: [0]"),
        ("negate: 0", "mode: fast"),
        ("negate: 0", "negate: 1\nmode: raw"),
        ("free_thresh: 0.196", "free_thresh: 0.7"),
        ("image: hall.pgm", "image: [a]"),
        ("image: hall.pgm", "image: hall.jpg"),
        ("image: hall.pgm", "image: other.pgm"),
        ("image: hall.pgm", "image: ."),
        (YAML, ""),
        (YAML, "- 1\n- 2\n"),
        (YAML, "a: [1, 2"),
        (YAML, "a: !!python/object/apply:os.system ['true']"),
        ("resolution: 0.5", "a: &a [x]\nresolution: *a"),
        ("resolution: 0.5", "a: &a {b: 1}\n<<: *a"),
        ("resolution: 0.5", "resolution: 1" + ":1" * 10_000),
        ("resolution: 0.5", "resolution: 2001-01-01"),
        ("negate: 0", "negate: 2001-99-99"),
        (YAML, "[" * 3000),
        (YAML, "a: " + "b" * 70_000),
    ],
)
def test_bad_yaml(tmp_path: Path, old: str, new: str) -> None:
    """One error that names the file, the key and what is wrong."""
    assert old in YAML
    path = ros_map(tmp_path, YAML.replace(old, new))
    with refused():
        read_grid(path)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"P5",
        b"P5\n2 1\n255\n\x00",
        b"P5\n-2 1\n255\n",
        b"P5\n0 0\n255\n",
        b"P6\n1 1\n70000\n",
        b"x",
    ],
)
def test_damaged_images(tmp_path: Path, content: bytes) -> None:
    """Our error with the image's name; no error and no warning of Pillow's."""
    path = ros_map(tmp_path)
    (tmp_path / "hall.pgm").write_bytes(content)
    with refused():
        read_grid(path)


def test_image_of_another_format(tmp_path: Path) -> None:
    """An ending is believed: what is no PNG within is refused, whatever Pillow could read."""
    Image.fromarray(SHADES).save(tmp_path / "hall.gif")
    (tmp_path / "hall.gif").rename(tmp_path / "hall.png")
    (tmp_path / "hall.yaml").write_text(YAML.replace("hall.pgm", "hall.png"))
    with refused():
        read_grid(tmp_path / "hall.yaml")


def test_grids_that_are_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The declared size is looked at before pixels are; ragged patterns are refused."""
    monkeypatch.setattr(occupancy, "MOST_CELLS", 5)
    with refused():
        read_grid(ros_map(tmp_path))
    monkeypatch.undo()
    (tmp_path / "hall.pgm").write_bytes(b"P5\n1000000 1000000\n255\n")
    with refused():
        read_grid(tmp_path / "hall.yaml")
    monkeypatch.setattr(occupancy, "MOST_EDGES", 100)
    with refused():
        polygons_of(np.indices((10, 10)).sum(axis=0) % 2 == 0)


CSV = """\
resolution_m,origin_x_m,origin_y_m,occupied_from
2.0,10.0,-5.0,65
-1,0,100
0,64,
"""


def test_csv(tmp_path: Path) -> None:
    """Per cent as in nav_msgs/OccupancyGrid; rows from the largest y down."""
    path = tmp_path / "yard.csv"
    path.write_text(CSV)
    grid = read_grid(path)
    assert grid.occupied.tolist() == [[False, False, False], [False, False, True]]
    assert grid.unknown.tolist() == [[False, False, True], [True, False, False]]
    assert (grid.resolution_m, grid.origin_m) == (2.0, (10.0, -5.0))
    (obstacle,) = read_obstacles(path, "free")
    assert (obstacle.name, obstacle.polygon.bounds) == ("yard", (14.0, -3.0, 16.0, -1.0))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("resolution_m", "cell_m"),
        ("2.0,10.0,-5.0,65", "2.0,10.0,-5.0"),
        ("2.0,10.0,-5.0,65", "2.0,east,-5.0,65"),
        ("2.0,10.0,-5.0,65", "2.0,,-5.0,65"),
        ("2.0,10.0,-5.0,65", "0,0,0,65"),
        ("0,64,", "0,64"),
        ("0,64,", "0,wall,1"),
        ("0,64,", "0,inf,1"),
        ("-1,0,100\n0,64,\n", ""),
        ("0,64,", '0,"64,'),
        (CSV, ""),
    ],
)
def test_bad_csv(tmp_path: Path, old: str, new: str) -> None:
    assert old in CSV
    path = tmp_path / "yard.csv"
    path.write_text(CSV.replace(old, new, 1))
    with refused():
        read_grid(path)


def test_in_a_problem(tmp_path: Path) -> None:
    """A grid next to the problem file is among its obstacles; a start in a wall is an error."""
    ros_map(tmp_path, YAML.replace("0.5", "10.0"), np.full((9, 12), 254, dtype=np.uint8))
    field = (Path(load("open_field").file or "")).read_text()
    head, rest = field.split("[channel.truth]", 1)
    world = '[world]\nbounds_m = [0.0, 1.0, 118.0, 91.0]\nobstacles = [{ file = "hall.yaml" }]\n'
    path = tmp_path / "field.toml"
    path.write_text(f"{head.split('[world]')[0]}{world}\n[channel.truth]{rest}")
    assert load(path).workspace.obstacles == ()
    shades = np.full((9, 12), 254, dtype=np.uint8)
    shades[-1 - 3, 9] = 0  # x from 88 to 98, y from 31 to 41: a metre above the goal
    Image.fromarray(shades).save(tmp_path / "hall.pgm")
    with refused():
        load(path)
    path.write_text(path.read_text().replace('"hall.yaml"', '"hall.yaml", unknown = "nothing"'))
    with refused():
        load(path)
    path.write_text(path.read_text().replace('file = "hall.yaml"', 'wkt = "POINT (1 1)"'))
    path.write_text(path.read_text().replace('"nothing"', '"free"'))
    with refused():
        load(path)


PATTERNS = arrays.arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9)))


def grid_of(
    occupied: NDArray[np.bool_], resolution_m: float = 1.0, origin_m: tuple[float, float] = (0, 0)
) -> OccupancyGrid:
    return OccupancyGrid(occupied, np.zeros_like(occupied), resolution_m, origin_m)


def polygons_of(occupied: NDArray[np.bool_], **options) -> list[shapely.Polygon]:
    return [obstacle.polygon for obstacle in grid_obstacles(grid_of(occupied, **options), "a")]


def cells_of(occupied: NDArray[np.bool_]) -> shapely.Geometry:
    """All occupied cells, each drawn as a box and joined by GEOS."""
    boxes = [shapely.box(x, y, x + 1, y + 1) for y, x in np.argwhere(occupied)]
    return shapely.union_all(boxes)


@settings(deadline=None)
@given(PATTERNS)
def test_union_is_the_cells(occupied: NDArray[np.bool_]) -> None:
    """Valid polygons that do not overlap and together are the cells, by GEOS's own union."""
    polygons = polygons_of(occupied)
    assert all(shapely.is_valid(polygons))
    assert shapely.area(polygons).sum() == occupied.sum()
    assert shapely.union_all(polygons).equals(cells_of(occupied))
    turns = [shapely.get_num_coordinates(polygon) for polygon in polygons]
    simple = [shapely.get_num_coordinates(shapely.simplify(p, 0.0)) for p in polygons]
    # Simplification keeps the first corner of a ring, so it can only be as short.
    assert turns == simple


@settings(deadline=None)
@given(arrays.arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 30))))
def test_squares_do_not_change_the_union(occupied: NDArray[np.bool_]) -> None:
    """Cut along squares of four cells, no obstacle leaves its square, and nothing is lost."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(occupancy, "TILE_CELLS", 4)
        polygons = polygons_of(occupied)
    assert all(shapely.is_valid(polygons))
    assert shapely.area(polygons).sum() == occupied.sum()
    for x_min, y_min, x_max, y_max in shapely.bounds(polygons):
        assert x_min // 4 == (x_max - 1) // 4 and y_min // 4 == (y_max - 1) // 4
    assert shapely.union_all(polygons).equals(cells_of(occupied))


def test_polygons_of_cells() -> None:
    """Place and scale, holes with islands, unknown cells, and names."""
    occupied = np.zeros((3, 4), dtype=bool)
    occupied[0, 1:3] = True
    (polygon,) = polygons_of(occupied, resolution_m=0.05, origin_m=(-10.0, 7.0))
    assert polygon.equals(shapely.box(-10.0 + 0.05, 7.0, -10.0 + 0.15000000000000002, 7.05))
    occupied = np.ones((7, 7), dtype=bool)
    occupied[1:6, 1:6] = False
    occupied[3, 3] = True
    first, second = sorted(polygons_of(occupied), key=lambda polygon: -polygon.area)
    assert (len(first.interiors), first.area, second.area) == (1, 24.0, 1.0)
    occupied, unknown = np.zeros((2, 5), dtype=bool), np.zeros((2, 5), dtype=bool)
    occupied[0, 0] = unknown[1, 4] = True
    grid = OccupancyGrid(occupied, unknown, 1.0, (0.0, 0.0))
    assert [obstacle.name for obstacle in grid_obstacles(grid, "hall")] == ["hall 1", "hall 2"]
    assert [obstacle.name for obstacle in grid_obstacles(grid, "hall", "free")] == ["hall"]
    assert grid_obstacles(grid_of(np.zeros((3, 3), dtype=bool)), "hall") == ()


def test_a_large_map_takes_seconds() -> None:
    """A thousand by a thousand cells of speckled rooms; CPU time, generously."""
    generator = np.random.default_rng(0)
    occupied = np.zeros((1000, 1000), dtype=bool)
    occupied[::50] = occupied[:, ::50] = True
    occupied |= generator.random(occupied.shape) < 0.02
    begun = time.process_time()
    polygons = polygons_of(occupied)
    assert time.process_time() - begun < 10.0
    assert shapely.area(polygons).sum() == occupied.sum()
    assert len(polygons) > (1000 // TILE_CELLS) ** 2
