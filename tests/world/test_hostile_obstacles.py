"""Obstacles that are no map: nested without end, of names that cannot be shown, in degrees."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

from planopt.errors import InputError
from planopt.world.readers import DEEPEST, obstacle_from_wkt, read_obstacles
from planopt.world.workspace import footprint

SQUARE = [[30.0, 40.0], [40.0, 40.0], [40.0, 50.0], [30.0, 40.0]]


def geojson(folder: Path, name: object = "a", ring: object = SQUARE, **more: object) -> Path:
    """A file of one feature."""
    feature = {
        "type": "Feature",
        "properties": {"name": name},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        **more,
    }
    path = folder / "map.geojson"
    path.write_text(json.dumps(feature))
    return path


@pytest.mark.parametrize("depth", [1500, 2_000_000])
def test_wkt_nested_without_end(depth: int, tmp_path: Path) -> None:
    """Refused before a parser that calls itself sees it; a million levels would end the process."""
    text = "GEOMETRYCOLLECTION (" * depth + "POLYGON ((1 1, 2 1, 2 2, 1 1))" + ")" * depth
    (tmp_path / "deep.wkt").write_text(text)
    with pytest.raises(InputError, match=rf"deep\.wkt: .*nested {depth + 2} deep"):
        read_obstacles(tmp_path / "deep.wkt")
    with pytest.raises(InputError, match="nested"):
        obstacle_from_wkt("deep", text)


def test_wkt_nested_as_deep_as_is_allowed() -> None:
    """The limit leaves room for collections in collections."""
    depth = DEEPEST - 2
    text = "GEOMETRYCOLLECTION (" * depth + "POLYGON ((1 1, 2 1, 2 2, 1 1))" + ")" * depth
    assert obstacle_from_wkt("deep", text).polygon.area == 0.5


@pytest.mark.parametrize("depth", [300, 100_000])
def test_json_nested_without_end(depth: int, tmp_path: Path) -> None:
    """Collections within collections, within Python's own limit and beyond it."""
    head, tail = '{"type": "GeometryCollection", "geometries": [', "]}"
    (tmp_path / "a.geojson").write_text(head * depth + '{"type": "Point"}' + tail * depth)
    with pytest.raises(InputError, match=r"a\.geojson"):
        read_obstacles(tmp_path / "a.geojson")


@pytest.mark.parametrize("name", ["\ud800", "a\ud800b", "\x1b[2J", "line\nbreak", "n" * 201])
def test_names_that_cannot_be_written_or_shown(name: str, tmp_path: Path) -> None:
    """Half a surrogate pair, terminal codes, and more than anyone reads: refused at load."""
    with pytest.raises(InputError, match="the name") as caught:
        read_obstacles(geojson(tmp_path, name))
    assert str(caught.value).isprintable() and len(str(caught.value)) < 300


def test_names_in_other_scripts(tmp_path: Path) -> None:
    """They are names."""
    for name in ("Müllerstraße 5", "東京駅", "🏠", "n" * 200):
        assert read_obstacles(geojson(tmp_path, name))[0].name == name


def test_degrees_are_not_taken_for_metres(tmp_path: Path) -> None:
    """A building of 20 m in Munich; metres of the same map are read."""
    ring = np.array(
        [[11.5754, 48.1371], [11.5757, 48.1371], [11.5757, 48.1373], [11.5754, 48.1371]]
    )
    with pytest.raises(InputError, match=r"11\.5754, 48\.1371, are degrees.*project"):
        read_obstacles(geojson(tmp_path, ring=ring.tolist()))
    metres = ((ring - ring.min(axis=0)) * [74_000.0, 111_000.0]).tolist()
    assert len(read_obstacles(geojson(tmp_path, ring=metres))) == 1


@pytest.mark.parametrize(
    "name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "EPSG:4326", "urn:ogc:def:crs:EPSG::4326"]
)
def test_a_reference_system_in_degrees(name: str, tmp_path: Path) -> None:
    """It is refused where the coordinates can be degrees; other systems are metres."""
    crs = {"type": "name", "properties": {"name": name}}
    with pytest.raises(InputError, match="are degrees"):
        read_obstacles(geojson(tmp_path, crs=crs))
    crs["properties"] = {"name": "EPSG:25832"}
    assert len(read_obstacles(geojson(tmp_path, crs=crs))) == 1


def test_a_small_scene_far_from_zero_by_its_own_size(tmp_path: Path) -> None:
    """Pegs on a table are metres."""
    ring = [[1.0, 1.0], [1.02, 1.0], [1.02, 1.02], [1.0, 1.0]]
    with pytest.raises(InputError, match="degrees"):
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
    with pytest.raises(InputError, match="not a simple polygon"):
        footprint("scribble", ring)
    assert time.process_time() - begun < 5.0


def test_a_long_outline_with_a_spike_is_repaired() -> None:
    """The limit is for outlines that cross themselves everywhere."""
    angle = np.linspace(0.0, 2.0 * np.pi, 5000, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]).tolist()
    spike = [ring[0], [2.0, 0.0], *ring]
    assert footprint("round", spike).polygon.area == pytest.approx(np.pi, rel=1e-5)


@pytest.mark.parametrize("ending", [".wkt", ".geojson", ".json"])
def test_a_pipe(ending: str, tmp_path: Path) -> None:
    """It is not waited for."""
    os.mkfifo(tmp_path / f"a{ending}")
    with pytest.raises(InputError, match="is not a regular file"):
        read_obstacles(tmp_path / f"a{ending}")
