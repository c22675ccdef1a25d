import json
from pathlib import Path

import pytest
import shapely

from planopt.errors import InputError
from planopt.world.readers import obstacle_from_wkt, read_obstacles
from planopt.world.workspace import Workspace

SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]
HOLE = [[1, 1], [2, 1], [2, 2], [1, 1]]
FAR = [[10, 0], [11, 0], [11, 1], [10, 0]]
POLYGON = {"type": "Polygon", "coordinates": [SQUARE, HOLE]}
TWO = {"type": "MultiPolygon", "coordinates": [[SQUARE, HOLE], [FAR]]}


def saved(folder: Path, name: str, content: object) -> Path:
    """Write text, or anything else as JSON."""
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def names_and_areas(path: Path) -> list[tuple[str, float]]:
    """What a test compares."""
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


def test_building_file(tmp_path: Path) -> None:
    """Buildings have names and may have holes; other keys are ignored."""
    buildings = [
        {"name": "Hall", "top_z": 9, "exterior": SQUARE, "holes": [HOLE]},
        {"exterior": FAR},
    ]
    path = saved(tmp_path, "a.json", {"frame": "x", "buildings": buildings})
    assert names_and_areas(path) == [("Hall", 15.5), ("building 2", 0.5)]


def test_byte_order_mark(tmp_path: Path) -> None:
    """Files saved by editors that put a mark first are read."""
    (tmp_path / "a.json").write_text(json.dumps(POLYGON), encoding="utf-8-sig")
    (tmp_path / "a.wkt").write_text(WKT_FAR, encoding="utf-8-sig")
    assert names_and_areas(tmp_path / "a.json") == [("a", 15.5)]
    assert names_and_areas(tmp_path / "a.wkt") == [("a", 0.5)]


def test_munich(munich: Workspace) -> None:
    """All 742 footprints come through, unchanged and valid."""
    polygons = [obstacle.polygon for obstacle in munich.obstacles]
    assert len(polygons) == 742
    assert shapely.is_valid(polygons).all()
    assert sum(len(polygon.interiors) for polygon in polygons) > 20


def test_every_format_gives_the_same_polygon(tmp_path: Path) -> None:
    """The same footprint through GeoJSON, WKT, building file and Python is the same polygon."""
    polygon = shapely.Polygon(SQUARE)
    files = [
        saved(tmp_path, "a.geojson", shapely.to_geojson(polygon)),
        saved(tmp_path, "a.wkt", polygon.wkt),
        saved(tmp_path, "a.json", {"buildings": [{"name": "a", "exterior": SQUARE}]}),
    ]
    read = [*(read_obstacles(path)[0] for path in files), obstacle_from_wkt("a", polygon.wkt)]
    assert all(obstacle.name == "a" and obstacle.polygon == polygon for obstacle in read)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.shp", "", "ending in '.shp'"),
        ("a.json", "{", "line 1: not JSON"),
        ("a.json", "[" * 100_000, "not JSON"),
        ("a.json", "[]", "a: \\[\\] is not an area"),
        ("a.json", {"buildings": 5}, "a: .*buildings.* is not an area"),
        ("a.json", {"buildings": [5]}, "building 1"),
        ("a.json", {"buildings": [{"name": "Hall"}]}, "building 1: .*no exterior"),
        ("a.json", {"buildings": [{"exterior": SQUARE, "holes": 4}]}, "building 1: .* holes"),
        ("a.json", '{"buildings": [{"name": "H", "exterior": [[0,0],[NaN,1],[1,1]]}]}', "H: .*nan"),
        ("a.geojson", {"type": "Point", "coordinates": [0, 0]}, "a: .*Point.* is not an area"),
        ("a.geojson", {"type": "Polygon", "coordinates": []}, "0 different corners"),
        ("a.geojson", {"type": "Polygon"}, "a: .*Polygon.* is not an area"),
        ("a.geojson", {"type": "Feature", "geometry": None}, "a: null is not an area"),
        ("a.geojson", {"type": "Feature", "geometry": ["x" * 99]}, "x\\.\\.\\."),
        ("a.geojson", {}, "a: {} is not an area"),
        ("a.wkt", " \n", "the file is empty"),
        ("a.wkt", "POINT (1 2)", "a Point is not an area"),
        ("a.wkt", "POLYGON EMPTY", "0 different corners"),
        ("a.wkt", "POLYGON ((0 0, 1 1)", "line 1: a: not WKT"),
        ("a.wkt", "CURVEPOLYGON ((0 0, 1 0, 1 1, 0 0))", "not WKT"),
        ("a.wkt", f"{WKT_SQUARE}\n\nPOLIGON ((0 0))\n", "line 3: a line 3: not WKT"),
        (
            "a.wkt",
            f"{WKT_SQUARE}\nPOLYGON ((0 0, 4 4, 4 0, 0 5))",
            "line 2: a line 2: not a simple",
        ),
        ("a.wkt", "POLYGON ((0 0, nan 0, 1 1, 0 0))", "nan"),
    ],
)
def test_bad_files(tmp_path: Path, name: str, content: object, says: str) -> None:
    """Each is one error that names the file and what is wrong in it."""
    path = saved(tmp_path, name, content)
    with pytest.raises(InputError, match=says) as caught:
        read_obstacles(path)
    assert str(caught.value).startswith(str(path))


def test_unreadable_files(tmp_path: Path) -> None:
    """A missing file and one that is not text are errors with the file."""
    with pytest.raises(InputError, match=r"none\.wkt: there is no such file"):
        read_obstacles(tmp_path / "none.wkt")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        read_obstacles(tmp_path / "binary.json")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("MULTIPOLYGON (((0 0, 1 0, 1 1, 0 0)), ((5 0, 6 0, 6 2, 5 0)))", "2 polygons"),
        ("GEOMETRYCOLLECTION EMPTY", "0 polygons"),
        ("nonsense", "Hall: not WKT"),
    ],
)
def test_one_obstacle_from_wkt(text: str, says: str) -> None:
    """Text that is not one polygon is refused."""
    with pytest.raises(InputError, match=says):
        obstacle_from_wkt("Hall", text)
