"""The lattice: free nodes and moves against GEOS, shortest paths against networkx."""

import math

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from refusals import refused
from scenes import small_road_map

from planopt import Obstacle, Workspace
from planopt.world import (
    MOVES,
    Lattice,
    build_lattice,
    build_road_map,
    index_obstacles,
    lattice_paths,
    moves_from,
    nearest_node,
    route_from,
    swept_clearance_m,
)

ORIGIN = np.zeros(2)
BOUNDS = (-20.0, -12.0, 20.0, 12.0)


def random_world(seed: int) -> Workspace:
    """Overlapping triangles, slivers and a frame within `BOUNDS`."""
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-20, 20, (5, 1, 2)) + rng.uniform(-5, 5, (5, 3, 2))
    frame = shapely.Polygon(
        [(-9, -9), (5, -9), (5, 5), (-9, 5)], [[(-8.9, -8.9), (4.9, -8.9), (4.9, 4.9), (-8.9, 4.9)]]
    )
    polygons = [*map(shapely.Polygon, triangles), frame]
    return Workspace(BOUNDS, tuple(Obstacle("o", polygon) for polygon in polygons))


def brute_force(
    workspace: Workspace, lattice: Lattice, step_m: float, margin_m: float
) -> NDArray[np.bool_]:
    positions = lattice.positions_m
    ny, nx = lattice.shape
    world = shapely.union_all([obstacle.polygon for obstacle in workspace.obstacles])
    expected = np.zeros((21, ny, nx), dtype=bool)
    for k, (dx, dy) in enumerate(MOVES):
        for iy in range(max(0, -dy), min(ny, ny - dy)):
            for ix in range(max(0, -dx), min(nx, nx - dx)):
                way = shapely.LineString([positions[iy, ix], positions[iy + dy, ix + dx]])
                near = way.distance(world) < margin_m or way.length > step_m + 1e-9
                expected[k, iy, ix] = not (near or way.intersects(world))
    return expected


def test_moves_are_all_up_to_a_knights() -> None:
    """21 different moves, the first is staying, and move k + 10 undoes move k."""
    disc = {(x, y) for x in range(-3, 4) for y in range(-3, 4) if x * x + y * y <= 5}
    assert {tuple(move) for move in MOVES.tolist()} == disc
    assert len(MOVES) == len(disc) == 21
    np.testing.assert_array_equal(MOVES[0], [0, 0])
    np.testing.assert_array_equal(MOVES[11:], -MOVES[1:11])
    assert not MOVES.flags.writeable


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.4, 2.0]), st.sampled_from([3.3, 6.0]))
def test_equal_to_brute_force(seed: int, margin_m: float, step_m: float) -> None:
    """Free nodes and open moves are exactly those that GEOS finds clear one by one."""
    workspace = random_world(seed)
    anchor = np.random.default_rng(seed).uniform(-5, 5, 2)
    lattice = build_lattice(workspace, anchor, step_m, margin_m)
    expected = brute_force(workspace, lattice, step_m, margin_m)
    np.testing.assert_array_equal(lattice.open_moves, expected)
    np.testing.assert_array_equal(lattice.free, expected[0])


def test_nodes_are_strictly_within_the_bounds() -> None:
    """Without obstacles every node is free; the nearest node is that of brute force."""
    anchor = np.array([3.0, 40.0])  # outside: nodes are only counted from it
    lattice = build_lattice(Workspace(BOUNDS, ()), anchor, math.sqrt(5), 2.0)
    positions = lattice.positions_m
    np.testing.assert_allclose(positions[0, 0], [-19, -11])
    np.testing.assert_allclose(positions[-1, -1], [19, 11])
    assert lattice.shape == (23, 39)
    assert lattice.spacing_m == pytest.approx(1.0)
    assert lattice.free.all()
    for (dx, dy), allowed in zip(MOVES, lattice.open_moves, strict=True):
        assert allowed.sum() == (39 - abs(dx)) * (23 - abs(dy))
    lattice = build_lattice(Workspace(BOUNDS, ()), np.array([0.3, 0.2]), 3.0, 0.0)
    positions = lattice.positions_m
    for place in np.random.default_rng(0).uniform((-40, -30), (40, 30), (50, 2)):
        iy, ix = nearest_node(lattice, place)
        distance = np.hypot(*np.moveaxis(positions - place, -1, 0))
        assert distance[iy, ix] == distance.min()


def test_thin_wall_closes_moves_across() -> None:
    """Free nodes on both sides, a wall without width to speak of between them."""
    wall = shapely.Polygon([(0.5, -20), (0.500001, -20), (0.500001, 20), (0.5, 20)])
    lattice = build_lattice(Workspace(BOUNDS, (Obstacle("wall", wall),)), ORIGIN, math.sqrt(5), 0.1)
    assert lattice.free.all()
    x = lattice.positions_m[..., 0]
    for (dx, _), allowed in zip(MOVES, lattice.open_moves, strict=True):
        crosses = (x < 0.5) != (x + dx < 0.5)
        assert not allowed[crosses].any()


@pytest.mark.parametrize("step_m", [500.0, 0.001])
def test_useless_lattices_are_refused(step_m: float) -> None:
    """No node, or more than memory holds, is an error that says what to change."""
    anchor = np.array([100.0, 100.0])
    with refused():
        build_lattice(Workspace(BOUNDS, ()), anchor, step_m, 2.0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_first_moves_by_brute_force(seed: int) -> None:
    """All nodes within reach, each open exactly if the straight path to it is clear."""
    workspace = random_world(seed)
    place = np.random.default_rng(seed + 1).uniform((-21, -13), (21, 13))
    lattice = build_lattice(workspace, ORIGIN, 6.0, 0.5)
    index = index_obstacles(workspace)
    iy, ix, ok = moves_from(index, lattice, place, 6.0, 0.5)
    positions = lattice.positions_m
    distance = np.hypot(*np.moveaxis(positions - place, -1, 0))
    assert set(zip(iy.tolist(), ix.tolist(), strict=True)) == set(
        map(tuple, np.argwhere(distance <= 6.0).tolist())
    )
    for y, x, open_way in zip(iy, ix, ok, strict=True):
        swept = swept_clearance_m(index, np.stack((place, positions[y, x])))
        assert open_way == (swept[0] >= 0.5)


WALL = shapely.box(4.4, 0.0, 4.6, 6.2)
BLOCK = shapely.Polygon([(6.5, 3.5), (8.4, 4.4), (7.4, 6.6)])


def free_lattice(free):
    """A lattice on which a move is open where both of its ends are free."""
    free = np.asarray(free, dtype=bool)
    opened = np.zeros((len(MOVES), *free.shape), dtype=bool)
    ny, nx_ = free.shape
    for k, (dx, dy) in enumerate(MOVES):
        for iy, ix in np.argwhere(free):
            jy, jx = iy + dy, ix + dx
            opened[k, iy, ix] = 0 <= jy < ny and 0 <= jx < nx_ and free[jy, jx]
    origin = np.array([2.0, -1.0])
    positions = origin + 0.5 * np.moveaxis(np.indices(free.shape)[::-1], 0, -1)
    return Lattice(origin, 0.5, free.shape, free, opened, positions, np.zeros((0, 2), np.intp))


def graph_of(road_map, factor=None):
    """The same graph for networkx, straight from the lattice's open moves."""
    lattice, graph = road_map.lattice, nx.Graph()
    graph.add_nodes_from(range(len(road_map.nodes_m)))
    places = lattice.positions_m
    for k, iy, ix in np.argwhere(lattice.open_moves):
        dx, dy = MOVES[k]
        a, b = road_map.number[iy, ix], road_map.number[iy + dy, ix + dx]
        length = float(np.linalg.norm(places[iy, ix] - places[iy + dy, ix + dx]))
        mean = 1.0 if factor is None else (factor[a] + factor[b]) / 2.0
        if a != b:
            graph.add_edge(int(a), int(b), weight=length * mean)
    return graph


def costs_by_networkx(road_map, goal, factor=None):
    """Costs to `goal`, infinite where there is no path."""
    found = nx.single_source_dijkstra_path_length(graph_of(road_map, factor), goal)
    return np.array([found.get(k, np.inf) for k in range(len(road_map.nodes_m))])


def assert_ways_lead_to_goal(road_map, ways, goal, factor=None):
    """Every next node is a move away and the costs fall by exactly that edge's cost."""
    graph = graph_of(road_map, factor)
    for node, following in enumerate(ways.next_node):
        if node == goal or not np.isfinite(ways.cost_m[node]):
            assert following < 0
            continue
        edge = graph.edges[node, int(following)]["weight"]
        assert ways.cost_m[node] == pytest.approx(edge + ways.cost_m[following], abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_costs_are_networkx_costs(seed, weighted):
    """On random lattices, with random factors or without; cut-off nodes are infinitely far."""
    generator = np.random.default_rng(seed)
    free = generator.random((5, 6)) > 0.35
    free[2, 3] = True
    road_map = build_road_map(free_lattice(free))
    goal = int(road_map.number[2, 3])
    factor = generator.uniform(1.0, 20.0, len(road_map.nodes_m)) if weighted else None
    ways = lattice_paths(road_map, goal, factor)
    np.testing.assert_allclose(ways.cost_m, costs_by_networkx(road_map, goal, factor), atol=1e-9)
    assert_ways_lead_to_goal(road_map, ways, goal, factor)


def test_round_a_wall():
    """Real obstacles: networkx agrees, and the path behind the wall leads around its end."""
    road_map = small_road_map(WALL, BLOCK, spacing_m=0.5)
    goal = int(road_map.number[4, 16])
    ways = lattice_paths(road_map, goal)
    np.testing.assert_allclose(ways.cost_m, costs_by_networkx(road_map, goal), atol=1e-9)
    start = int(road_map.number[2, 2])
    way = route_from(road_map, ways, start, 100.0)
    places = road_map.nodes_m[way]
    assert way[0] == start
    assert way[-1] == goal
    assert places[:, 1].max() > 6.2
    line = shapely.LineString(places)
    assert min(line.distance(WALL), line.distance(BLOCK)) >= 0.1
    assert line.length == pytest.approx(ways.cost_m[start])


def test_numbering_and_sources():
    """Numbers, positions and rows agree, and a source's move arrives where it says."""
    road_map = small_road_map(WALL, BLOCK)
    lattice, count = road_map.lattice, len(road_map.nodes_m)
    assert count == lattice.free.sum() < lattice.free.size
    np.testing.assert_array_equal(road_map.number[road_map.rows, road_map.columns], range(count))
    assert (road_map.number[~lattice.free] == -1).all()
    np.testing.assert_array_equal(
        lattice.positions_m[road_map.rows, road_map.columns], road_map.nodes_m
    )
    opened = 0
    for node in range(count):
        for k, (dx, dy) in enumerate(MOVES):
            source = road_map.sources[node, k]
            if source == count:
                continue
            opened += 1
            assert lattice.open_moves[k, road_map.rows[source], road_map.columns[source]]
            assert road_map.rows[source] + dy == road_map.rows[node]
            assert road_map.columns[source] + dx == road_map.columns[node]
    assert opened == lattice.open_moves.sum()
    assert len(road_map.edge_to) == opened - count  # all moves but "stay"
    steps = road_map.nodes_m[road_map.edge_to] - road_map.nodes_m[road_map.edge_from]
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), road_map.edge_length_m, atol=1e-12)


def test_path_ends_at_the_given_length():
    """At the first node past the length, at the goal, or at once where there is no path."""
    road_map = small_road_map()
    goal, start = int(road_map.number[0, 8]), int(road_map.number[0, 0])
    ways = lattice_paths(road_map, goal)
    np.testing.assert_array_equal(route_from(road_map, ways, start, 0.0), [start])
    for length in (0.5, 1.0, 3.0, 4.5, 7.9):
        way = route_from(road_map, ways, start, length)
        steps = np.linalg.norm(np.diff(road_map.nodes_m[way], axis=0), axis=1)
        assert steps.sum() >= length > steps[:-1].sum()
    assert route_from(road_map, ways, start, 1e6)[-1] == goal
    np.testing.assert_array_equal(route_from(road_map, ways, goal, 5.0), [goal])
    road_map = small_road_map(shapely.box(4.2, -1.0, 4.8, 9.0))
    ways = lattice_paths(road_map, int(road_map.number[3, 8]))
    here = int(road_map.number[3, 1])
    assert np.isinf(ways.cost_m[here])
    np.testing.assert_array_equal(route_from(road_map, ways, here, 5.0), [here])
