"""Shortest paths around obstacles: closed forms, and a plain visibility graph."""

import math

import numpy as np
import pytest
import shapely
from scipy.sparse.csgraph import dijkstra

from planopt import Obstacle, Workspace
from planopt.world import (
    index_obstacles,
    is_near_joined,
    path_lengths_m,
    segment_clearance_m,
    turns_m,
)
from planopt.world.shortest_paths import shortest_paths

BOUNDS = (0.0, 0.0, 40.0, 30.0)
START = np.array([5.0, 15.0])
BLOCK = shapely.box(10, 10, 20, 20)
RING = shapely.box(9, 9, 21, 21).difference(shapely.box(9.01, 9.01, 20.99, 20.99))


def ways_of(*polygons, start=START, clearance=0.0, radius=60.0, inner=True):
    obstacles = tuple(Obstacle(f"{k}", polygon) for k, polygon in enumerate(polygons))
    index = index_obstacles(Workspace(BOUNDS, obstacles))
    return index, shortest_paths(index, BOUNDS, start, clearance, radius, inner)


def length_to(ways, x, y):
    return path_lengths_m(ways, np.array([[x, y]]))[0]


def test_round_a_block():
    """Straight in the open, by two corners round a block, and no farther than the radius."""
    _, ways = ways_of()
    assert length_to(ways, 8.0, 19.0) == pytest.approx(5.0)
    _, ways = ways_of(BLOCK)
    exact = 2.0 * math.hypot(5.0, 5.0) + 10.0
    assert length_to(ways, 25.0, 15.0) == pytest.approx(exact)
    turns = turns_m(ways, np.array([25.0, 15.0]))
    assert turns is not None
    assert len(turns) == 3
    assert math.isinf(length_to(ways, 15.0, 15.0))
    for radius, reached in ((24.0, False), (24.2, True)):
        _, ways = ways_of(BLOCK, radius=radius)
        assert math.isfinite(length_to(ways, 25.0, 15.0)) == reached


@pytest.mark.parametrize("clearance", [0.1, 0.5, 2.0])
def test_with_a_clearance(clearance):
    """Tangents and arcs: one bound below, one above, four per cent apart at most."""
    tangent = math.sqrt(50.0 - clearance**2)
    # The arc turns from the tangent to the direction of the block's edge.
    turn = math.radians(45.0) + math.asin(clearance / math.sqrt(50.0))
    exact = 2.0 * (tangent + clearance * turn) + 10.0
    _, inner = ways_of(BLOCK, clearance=clearance)
    index, outer = ways_of(BLOCK, clearance=clearance, inner=False)
    below, above = (length_to(ways, 25.0, 15.0) for ways in (inner, outer))
    assert below <= exact + 1e-9
    assert above >= exact - 1e-9
    assert above - below <= 0.04 * exact
    turns = turns_m(outer, np.array([25.0, 15.0]))
    assert turns is not None
    way = np.vstack([START, turns])
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() == pytest.approx(above)
    assert segment_clearance_m(index, way[:-1], way[1:]).min() >= clearance - 1e-9


def test_closed_ways():
    """Thin walls and the border close; a start within the clearance still has a way."""
    inside = np.array([15.0, 15.0])
    for start, other in ((inside, START), (START, inside)):
        _, ways = ways_of(RING, start=start)
        assert math.isinf(length_to(ways, *other))
        assert not is_near_joined(ways, other[None], 0.5)[0]
    wall = shapely.box(10, -1, 11, 20)
    _, ways = ways_of(wall)
    exact = math.hypot(5, 5) + 1.0 + math.hypot(5, 5)
    assert length_to(ways, 16.0, 15.0) == pytest.approx(exact)
    _, ways = ways_of(BLOCK, start=np.array([9.8, 15.0]), clearance=0.5)
    assert length_to(ways, 5.0, 15.0) == pytest.approx(4.8)


def plain_lengths(polygons, places):
    """All lengths between places by the whole visibility graph."""
    closed = shapely.union_all(polygons)
    corners = np.concatenate([shapely.get_coordinates(p.exterior)[:-1] for p in polygons])
    inside = (corners >= BOUNDS[:2]).all(axis=1) & (corners <= BOUNDS[2:]).all(axis=1)
    nodes = np.vstack([places, corners[inside]])
    graph = np.zeros((len(nodes), len(nodes)))
    for i in range(len(nodes)):
        for j in range(i):
            way = shapely.LineString(nodes[[i, j]])
            if way.intersection(closed.buffer(-1e-7)).length < 1e-7:
                graph[i, j] = way.length
    return dijkstra(graph, directed=False, indices=range(len(places)))[:, : len(places)]


def test_against_the_whole_graph():
    """Random triangles and boxes, some overlapping, some across the border."""
    rng = np.random.default_rng(7)
    infinite = bent = 0
    for _ in range(12):
        middles = rng.uniform((8, 0), (36, 30), (7, 2))
        polygons = [
            shapely.MultiPoint(middle + rng.uniform(-6, 6, (4, 2))).convex_hull
            for middle in middles
        ]
        free = shapely.box(*BOUNDS).difference(shapely.union_all(polygons).buffer(0.05))
        places = rng.uniform(BOUNDS[:2], BOUNDS[2:], (60, 2))
        places = places[shapely.contains_xy(free, *places.T)][:6]
        expected = plain_lengths(polygons, places)
        found = np.array(
            [path_lengths_m(ways_of(*polygons, start=place)[1], places) for place in places]
        )
        assert np.isfinite(found).tolist() == np.isfinite(expected).tolist()
        finite = np.isfinite(expected)
        assert found[finite] == pytest.approx(expected[finite], abs=1e-5)
        air = np.linalg.norm(places[:, None] - places, axis=2)
        infinite += int((~finite).sum())
        bent += int((expected[finite] > air[finite] + 1e-3).sum())
    assert bent > 50
