"""Obstacles from files and rings: GeoJSON, WKT, buildings, and what is no map."""

import json
import math
import time
from pathlib import Path

import numpy as np
import pytest
import shapely
from refusals import refused

from planopt import Workspace, obstacles_from
from planopt.problems.schema import WorldTable
from planopt.world import footprint, obstacle_from_wkt, read_obstacles
from planopt.world.geodesy import longitude_latitude_deg

SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]
HOLE = [[1, 1], [2, 1], [2, 2], [1, 1]]
FAR = [[10, 0], [11, 0], [11, 1], [10, 0]]
POLYGON = {"type": "Polygon", "coordinates": [SQUARE, HOLE]}
TWO = {"type": "MultiPolygon", "coordinates": [[SQUARE, HOLE], [FAR]]}


def saved(folder: Path, name: str, content: object) -> Path:
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def names_and_areas(path: Path) -> list[tuple[str, float]]:
    return [(obstacle.name, obstacle.polygon.area) for obstacle in read_obstacles(path)]


@pytest.mark.parametrize("ending", ["geojson", "json", "GeoJSON"])
def test_geojson_features(tmp_path: Path, ending: str) -> None:
    """Features are named by property, id or number; parts of a MultiPolygon by number."""
    features = [
        {"type": "Feature", "properties": {"name": "Hall"}, "geometry": POLYGON},
        {"type": "Feature", "properties": {}, "id": 7, "geometry": POLYGON},
        {"type": "Feature", "properties": None, "geometry": TWO},
    ]
    path = saved(tmp_path, f"a.{ending}", {"type": "FeatureCollection", "features": features})
    assert names_and_areas(path) == [
        ("Hall", 15.5),
        ("7", 15.5),
        ("feature 3 part 1", 15.5),
        ("feature 3 part 2", 0.5),
    ]


@pytest.mark.parametrize(
    ("content", "names"),
    [
        (POLYGON, ["a"]),
        ({"type": "Feature", "geometry": POLYGON}, ["a"]),
        (
            {"type": "GeometryCollection", "geometries": [POLYGON, POLYGON]},
            ["a part 1", "a part 2"],
        ),
        ({"type": "FeatureCollection", "features": []}, []),
    ],
)
def test_geojson_without_collection(tmp_path: Path, content: object, names: list[str]) -> None:
    """A bare geometry or feature takes the name of the file."""
    read = names_and_areas(saved(tmp_path, "a.geojson", content))
    assert read == [(name, 15.5) for name in names]


WKT_SQUARE = "POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0), (1 1, 2 1, 2 2, 1 1))"
WKT_FAR = "POLYGON ((10 0, 11 0, 11 1))"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (WKT_SQUARE, [("a", 15.5)]),
        (WKT_SQUARE.replace("), (", "),\n ("), [("a", 15.5)]),
        (f"\n{WKT_SQUARE}\n\n{WKT_FAR}\n", [("a line 2", 15.5), ("a line 4", 0.5)]),
        (f"GEOMETRYCOLLECTION ({WKT_SQUARE})", [("a", 15.5)]),
        (
            "MULTIPOLYGON (((0 0, 1 0, 1 1, 0 0)), ((5 0, 6 0, 6 2, 5 0)))",
            [("a part 1", 0.5), ("a part 2", 1.0)],
        ),
        ("POLYGON Z ((0 0 9, 1 0 9, 1 1 9, 0 0 9))", [("a", 0.5)]),
    ],
)
def test_wkt(tmp_path: Path, text: str, expected: list[tuple[str, float]]) -> None:
    """One geometry over any number of lines, or one a line; rings need not be closed."""
    assert names_and_areas(saved(tmp_path, "a.wkt", text)) == expected


def test_building_files(tmp_path: Path, munich: Workspace) -> None:
    """Buildings have names and holes; all 742 footprints of Munich are valid."""
    buildings = [
        {"name": "Hall", "top_z": 9, "exterior": SQUARE, "holes": [HOLE]},
        {"exterior": FAR},
    ]
    path = saved(tmp_path, "a.json", {"frame": "x", "buildings": buildings})
    assert names_and_areas(path) == [("Hall", 15.5), ("building 2", 0.5)]
    polygons = [obstacle.polygon for obstacle in munich.obstacles]
    assert len(polygons) == 742
    assert shapely.is_valid(polygons).all()
    assert sum(len(polygon.interiors) for polygon in polygons) > 20


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.shp", ""),
        ("a.json", "{"),
        ("a.json", "[" * 100_000),
        ("a.json", "[]"),
        ("a.json", {"buildings": 5}),
        ("a.json", {"buildings": [5]}),
        ("a.json", {"buildings": [{"name": "Hall"}]}),
        ("a.json", {"buildings": [{"exterior": SQUARE, "holes": 4}]}),
        ("a.json", '{"buildings": [{"name": "H", "exterior": [[0,0],[NaN,1],[1,1]]}]}'),
        ("a.geojson", {"type": "Point", "coordinates": [0, 0]}),
        ("a.geojson", {"type": "Polygon", "coordinates": []}),
        ("a.geojson", {"type": "Polygon"}),
        ("a.geojson", {"type": "Feature", "geometry": None}),
        ("a.geojson", {"type": "Feature", "geometry": ["x" * 99]}),
        ("a.geojson", {}),
        ("a.wkt", " \n"),
        ("a.wkt", "POINT (1 2)"),
        ("a.wkt", "POLYGON EMPTY"),
        ("a.wkt", "POLYGON ((0 0, 1 1)"),
        ("a.wkt", "CURVEPOLYGON ((0 0, 1 0, 1 1, 0 0))"),
        ("a.wkt", f"{WKT_SQUARE}\n\nPOLIGON ((0 0))\n"),
        ("a.wkt", f"{WKT_SQUARE}\nPOLYGON ((0 0, 4 4, 4 0, 0 5))"),
        ("a.wkt", "POLYGON ((0 0, nan 0, 1 1, 0 0))"),
    ],
)
def test_bad_files(tmp_path: Path, name: str, content: object) -> None:
    """Each is one error that names the file and what is wrong in it."""
    path = saved(tmp_path, name, content)
    with refused() as caught:
        read_obstacles(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    "text",
    [
        "MULTIPOLYGON (((0 0, 1 0, 1 1, 0 0)), ((5 0, 6 0, 6 2, 5 0)))",
        "GEOMETRYCOLLECTION EMPTY",
        "nonsense",
    ],
)
def test_one_obstacle_from_wkt(text: str) -> None:
    """Text that is not one polygon is refused."""
    with refused():
        obstacle_from_wkt("Hall", text)


CORNERS = [(0, 0), (4, 0), (4, 4), (0, 4)]


@pytest.mark.parametrize(
    "ring", [CORNERS, [*CORNERS, CORNERS[0]], CORNERS[::-1], np.array(CORNERS)]
)
def test_closing_direction_and_type_do_not_matter(ring: object) -> None:
    """A ring means the same open or closed, in either direction, as list or array."""
    assert footprint("a", ring).polygon.area == 16.0


def test_repaired_outlines() -> None:
    """Holes are cut out and heights left out; spikes and holes on the border are repaired."""
    polygon = footprint(
        "a", [(*corner, 7) for corner in CORNERS], [[(1, 1), (2, 1), (2, 2)]]
    ).polygon
    assert polygon.area == 15.5
    assert not polygon.has_z
    polygon = footprint("a", [(0, 0), (4, 0), (4, 4), (2, 4), (2, 9), (2, 4), (0, 4)]).polygon
    assert polygon.is_valid
    assert polygon.bounds == (0, 0, 4, 4)
    polygon = footprint("a", CORNERS, [[(0, 1), (0, 2), (1, 2), (1, 1)]]).polygon
    assert polygon.is_valid
    assert polygon.area == 15.0


@pytest.mark.parametrize(
    ("ring", "holes"),
    [
        ([(0, 0), (4, 4), (4, 0), (0, 5)], []),
        ([(0, 0), (4, 4), (4, 0), (0, 4)], []),
        ([(0, 0), (1, 0), (2, 0)], []),
        ([(0, 0), (1, 0), (0, 0)], []),
        (CORNERS, [[(9, 9), (8, 9), (8, 8)]]),
        (CORNERS, [[(1, 1), (2, 1)]]),
        ([(0, 0), (math.nan, 0), (1, 1)], []),
        ([(0, 0), (math.inf, 0), (1, 1)], []),
        ([(0, 0), (10**400, 0), (1, 1)], []),
        ([(0, 0), ("1", 0), (1, 1)], []),
        ([(0, 0), (True, 0), (1, 1)], []),
        ([(0, 0), "12", (1, 1)], []),
        ([(0, 0), (1,), (1, 1)], []),
        ([(0, 0), 5, (1, 1)], []),
        ("ring", []),
        (None, []),
    ],
)
def test_bad_rings_are_named(ring: object, holes: list[object]) -> None:
    """Whatever cannot be one polygon is an error with the feature and the reason."""
    with refused() as caught:
        footprint("Town Hall", ring, holes)
    assert caught.value.message.startswith("Town Hall: ")


TRIANGLE = [[30.0, 40.0], [40.0, 40.0], [40.0, 50.0], [30.0, 40.0]]


def geojson(folder: Path, name: object = "a", ring: object = TRIANGLE, **more: object) -> Path:
    feature = {
        "type": "Feature",
        "properties": {"name": name},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        **more,
    }
    path = folder / "map.geojson"
    path.write_text(json.dumps(feature))
    return path


ORIGIN = (48.1374, 11.5755, 20.0)
BLOCK = np.array([[10.0, 5.0], [40.0, 5.0], [40.0, 25.0], [10.0, 25.0], [10.0, 5.0]])


def in_system(code: int) -> np.ndarray:
    """The block's corners in a reference system."""
    degrees = longitude_latitude_deg(BLOCK, ORIGIN)
    if code == 4326:
        return degrees
    pyproj = pytest.importorskip("pyproj")
    convert = pyproj.Transformer.from_crs(4326, code, always_xy=True)
    return np.stack(convert.transform(*degrees.T), axis=-1)


@pytest.mark.parametrize("code", [None, 4326, 25832, 3857])
def test_reference_systems_become_metres(code: int | None, tmp_path: Path) -> None:
    """By the origin of the frame, from degrees by RFC 7946 and from systems by number."""
    named = {"crs": {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{code}"}}}
    more = {} if code is None else named
    path = geojson(tmp_path, ring=in_system(code or 4326).tolist(), **more)
    (found,) = read_obstacles(path, origin_deg=ORIGIN)
    np.testing.assert_allclose(shapely.get_coordinates(found.polygon), BLOCK, atol=2e-3)
    (found,) = obstacles_from(path, origin_deg=ORIGIN)
    assert found.polygon.area == pytest.approx(600.0, rel=1e-4)
    tables = [{"file": path.name, "origin_deg": list(ORIGIN)}]
    context, world = {"folder": tmp_path}, {"bounds_m": [0, 0, 100, 100], "obstacles": tables}
    (found,) = WorldTable.model_validate(world, context=context).obstacles
    assert found.polygon.area == pytest.approx(600.0, rel=1e-4)


def test_metres_remain_metres(tmp_path: Path) -> None:
    """A file without a system whose numbers are far from the origin in degrees."""
    path = geojson(tmp_path, ring=BLOCK.tolist())
    (found,) = read_obstacles(path, origin_deg=ORIGIN)
    np.testing.assert_array_equal(shapely.get_coordinates(found.polygon), BLOCK)


@pytest.mark.parametrize(("code", "origin"), [(999999, ORIGIN), (25832, (0.0, 90.0))])
def test_systems_that_do_not_fit(code: int, origin: tuple[float, ...], tmp_path: Path) -> None:
    named = {"crs": {"type": "name", "properties": {"name": f"EPSG:{code}"}}}
    path = geojson(tmp_path, ring=in_system(25832).tolist(), **named)
    with refused():
        read_obstacles(path, origin_deg=origin)


def test_lists_that_are_no_geojson(tmp_path: Path) -> None:
    with refused():
        read_obstacles(saved(tmp_path, "map.json", [[[1.0, 2.0]]]), origin_deg=ORIGIN)


def test_geodataframes_of_any_system() -> None:
    geopandas = pytest.importorskip("geopandas")
    polygon = shapely.Polygon(in_system(25832))
    frame = geopandas.GeoDataFrame({"name": ["block"]}, geometry=[polygon], crs=25832)
    (found,) = obstacles_from(frame, origin_deg=ORIGIN)
    assert found.name == "block"
    np.testing.assert_allclose(shapely.get_coordinates(found.polygon), BLOCK, atol=2e-3)


@pytest.mark.parametrize("depth", [1500, 300_000])
def test_wkt_nested_without_end(depth: int, tmp_path: Path) -> None:
    """Refused before a parser that calls itself sees it; a million levels would end the process."""
    text = "GEOMETRYCOLLECTION (" * depth + "POLYGON ((1 1, 2 1, 2 2, 1 1))" + ")" * depth
    (tmp_path / "deep.wkt").write_text(text)
    with refused():
        read_obstacles(tmp_path / "deep.wkt")
    with refused():
        obstacle_from_wkt("deep", text)


@pytest.mark.parametrize("depth", [300, 100_000])
def test_json_nested_without_end(depth: int, tmp_path: Path) -> None:
    """Collections within collections, within Python's own limit and beyond it."""
    head, tail = '{"type": "GeometryCollection", "geometries": [', "]}"
    (tmp_path / "a.geojson").write_text(head * depth + '{"type": "Point"}' + tail * depth)
    with refused():
        read_obstacles(tmp_path / "a.geojson")


@pytest.mark.parametrize("name", ["\ud800", "a\ud800b", "\x1b[2J", "line\nbreak", "n" * 201])
def test_names_that_cannot_be_written_or_shown(name: str, tmp_path: Path) -> None:
    """Half a surrogate pair, terminal codes, and more than anyone reads: refused at load."""
    with refused() as caught:
        read_obstacles(geojson(tmp_path, name))
    assert str(caught.value).isprintable() and len(str(caught.value)) < 300


def test_names_in_other_scripts(tmp_path: Path) -> None:
    for name in ("Müllerstraße 5", "東京駅", "🏠", "n" * 200):
        assert read_obstacles(geojson(tmp_path, name))[0].name == name


def test_degrees_are_not_taken_for_metres(tmp_path: Path) -> None:
    """A building of 20 m in Munich; metres of the same map are read."""
    ring = np.array(
        [[11.5754, 48.1371], [11.5757, 48.1371], [11.5757, 48.1373], [11.5754, 48.1371]]
    )
    with refused():
        read_obstacles(geojson(tmp_path, ring=ring.tolist()))
    metres = ((ring - ring.min(axis=0)) * [74_000.0, 111_000.0]).tolist()
    assert len(read_obstacles(geojson(tmp_path, ring=metres))) == 1


@pytest.mark.parametrize(
    "name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "EPSG:4326", "urn:ogc:def:crs:EPSG::4326"]
)
def test_a_reference_system_in_degrees(name: str, tmp_path: Path) -> None:
    """It is refused where the coordinates can be degrees; other systems are metres."""
    crs = {"type": "name", "properties": {"name": name}}
    with refused():
        read_obstacles(geojson(tmp_path, crs=crs))
    crs["properties"] = {"name": "EPSG:25832"}
    assert len(read_obstacles(geojson(tmp_path, crs=crs))) == 1


def test_a_small_scene_far_from_zero_by_its_own_size(tmp_path: Path) -> None:
    ring = [[1.0, 1.0], [1.02, 1.0], [1.02, 1.02], [1.0, 1.0]]
    with refused():
        read_obstacles(geojson(tmp_path, ring=ring))
    more = {"type": "Polygon", "coordinates": [[[0.1, 0.1], [0.2, 0.1], [0.2, 0.2], [0.1, 0.1]]]}
    collection = {"type": "GeometryCollection", "geometries": [more]}
    collection["geometries"].append({"type": "Polygon", "coordinates": [ring]})
    (tmp_path / "table.geojson").write_text(json.dumps(collection))
    assert len(read_obstacles(tmp_path / "table.geojson")) == 2


def test_an_outline_that_crosses_itself_everywhere() -> None:
    """Repairing it would take minutes and gigabytes: it is refused at once."""
    ring = np.random.default_rng(0).uniform(0.0, 100.0, (20_000, 2)).tolist()
    begun = time.process_time()
    with refused():
        footprint("scribble", ring)
    assert time.process_time() - begun < 5.0
