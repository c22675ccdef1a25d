"""Shortest ways on the lattice against networkx, by mirror images and by closed forms."""

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import small_road_map

from planopt.world.lattice import (
    MOVES,
    Lattice,
    build_road_map,
    lattice_paths,
    node_positions,
    route_from,
)

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
    return Lattice(np.array([2.0, -1.0]), 0.5, free.shape, free, opened)


def graph_of(road_map, factor=None):
    """The same graph for networkx, straight from the lattice's open moves."""
    lattice, graph = road_map.lattice, nx.Graph()
    graph.add_nodes_from(range(len(road_map.nodes_m)))
    places = node_positions(lattice)
    for k, iy, ix in np.argwhere(lattice.open_moves):
        dx, dy = MOVES[k]
        a, b = road_map.number[iy, ix], road_map.number[iy + dy, ix + dx]
        length = float(np.linalg.norm(places[iy, ix] - places[iy + dy, ix + dx]))
        mean = 1.0 if factor is None else (factor[a] + factor[b]) / 2.0
        if a != b:
            graph.add_edge(int(a), int(b), weight=length * mean)
    return graph


def costs_by_networkx(road_map, goal, factor=None):
    """Costs to `goal`, infinite where there is no way."""
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
    """Real obstacles: networkx agrees, and the way behind the wall leads round its end."""
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
        node_positions(lattice)[road_map.rows, road_map.columns], road_map.nodes_m
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


def test_a_mirrored_scene_has_mirrored_ways():
    """Mirroring obstacles and goal about x = 5 mirrors the costs."""
    here = small_road_map(WALL, BLOCK)
    mirrored = [
        shapely.transform(p, lambda xy: xy * [-1.0, 1.0] + [10.0, 0.0]) for p in (WALL, BLOCK)
    ]
    there = small_road_map(*mirrored, anchor_m=(9.0, 1.0))
    np.testing.assert_array_equal(here.lattice.free[:, ::-1], there.lattice.free)
    goal, mirrored_goal = here.number[2, 7], there.number[2, -8]
    cost, mirrored_cost = np.full((2, *here.lattice.shape), np.nan)
    cost[here.rows, here.columns] = lattice_paths(here, int(goal)).cost_m
    mirrored_cost[there.rows, there.columns] = lattice_paths(there, int(mirrored_goal)).cost_m
    np.testing.assert_allclose(cost[:, ::-1], mirrored_cost, atol=1e-9)


def test_a_factor_of_one_is_plain():
    """No factor and a factor of 1 give the same ways; a factor of 3 costs three times as much."""
    road_map = small_road_map(WALL)
    plain = lattice_paths(road_map, 5)
    ones = lattice_paths(road_map, 5, np.ones(len(road_map.nodes_m)))
    np.testing.assert_array_equal(plain.cost_m, ones.cost_m)
    np.testing.assert_array_equal(plain.next_node, ones.next_node)
    threes = lattice_paths(road_map, 5, np.full(len(road_map.nodes_m), 3.0))
    np.testing.assert_allclose(threes.cost_m, 3.0 * plain.cost_m)


def test_costs_are_symmetric_and_bounded():
    """From a to b costs what b to a does, at least the distance; 2.8 % more at most if free."""
    road_map = small_road_map(spacing_m=0.5)
    centre = int(road_map.number[7, 9])
    costs = lattice_paths(road_map, centre).cost_m
    distance = np.linalg.norm(road_map.nodes_m - road_map.nodes_m[centre], axis=1)
    assert (costs >= distance - 1e-9).all()
    assert (costs <= 1.028 * distance + 1e-9).all()
    for node in (0, 17, len(costs) - 1):
        assert lattice_paths(road_map, node).cost_m[centre] == pytest.approx(costs[node])


def test_costs_avoid_dear_places():
    """A dear column is crossed at its cheap end if the way round is shorter than the charge."""
    road_map = small_road_map()
    factor = np.ones(len(road_map.nodes_m))
    dear = (np.abs(road_map.nodes_m[:, 0] - 5.0) <= 1.0) & (road_map.nodes_m[:, 1] < 6.5)
    factor[dear] = 100.0
    start, goal = road_map.number[0, 0], int(road_map.number[0, -1])
    way = route_from(road_map, lattice_paths(road_map, goal, factor), int(start), 100.0)
    assert not dear[way].any()


def test_a_way_ends_once_it_is_long_enough():
    """It stops at the first node past the length, at the goal, and where there is no way."""
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


def test_an_island_has_no_way():
    """Behind a wall without an end the cost is infinite and the way is the node alone."""
    road_map = small_road_map(shapely.box(4.2, -1.0, 4.8, 9.0))
    ways = lattice_paths(road_map, int(road_map.number[3, 8]))
    here = int(road_map.number[3, 1])
    assert np.isinf(ways.cost_m[here])
    np.testing.assert_array_equal(route_from(road_map, ways, here, 5.0), [here])
