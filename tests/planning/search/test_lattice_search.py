"""The lattice search against every path there is, on lattices small enough to list them all."""

from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scenes import small_road_map

from planopt.planning.search.lattice_search import search_cheapest
from planopt.planning.search.moving_moves import move_table
from planopt.world.lattice import MOVES, Lattice, build_road_map, lattice_paths

STEP_S, WEIGHT = 0.8, 0.3


def random_road_map(generator, shape=(3, 4), blocked=0.2, closed=0.1):
    """A lattice with blocked nodes and, between free ones, some closed moves."""
    ny, nx = shape
    free = generator.random(shape) >= blocked
    free[1, 1] = True
    opened = np.zeros((len(MOVES), ny, nx), dtype=bool)
    for k, (dx, dy) in enumerate(MOVES):
        for iy, ix in np.argwhere(free):
            jy, jx = iy + dy, ix + dx
            inside = 0 <= jy < ny and 0 <= jx < nx and free[jy, jx]
            opened[k, iy, ix] = inside and (k == 0 or generator.random() >= closed)
    return build_road_map(Lattice(np.array([0.0, 0.0]), 0.7, shape, free, opened))


def step_cost(length_m):
    """Cost of a step, written out again."""
    return STEP_S + WEIGHT * length_m**2 / STEP_S


def targets_of(road_map, node):
    """Nodes that a move leads to, straight from the lattice, with the cost of the move."""
    for k, (dx, dy) in enumerate(MOVES):
        row, column = road_map.rows[node], road_map.columns[node]
        if road_map.lattice.open_moves[k, row, column]:
            length = road_map.lattice.spacing_m * float(np.hypot(dx, dy))
            yield int(road_map.number[row + dy, column + dx]), step_cost(length)


def cost_of(road_map, nodes, first_nodes, first_lengths, goal, penalty, terminal):
    """Cost of one path; infinite where a move of it is closed."""
    first = dict(zip(map(int, first_nodes), map(step_cost, first_lengths), strict=True))
    total = first.get(int(nodes[0]), np.inf) + penalty[nodes[0]]
    for a, b in pairwise(nodes):
        moves = dict(targets_of(road_map, a))
        if a == b == goal:
            moves[b] = 0.0
        total = total + moves.get(int(b), np.inf) + penalty[b]
    return total + terminal[nodes[-1]]


def brute_force(road_map, first_nodes, first_lengths, horizon, goal, penalty, terminal):
    """Cost of the cheapest path by listing all of them."""
    moves = [dict(targets_of(road_map, n)) for n in range(len(road_map.nodes_m))]
    if 0 <= goal < len(moves):
        moves[goal][goal] = 0.0
    paths = [
        (int(n), step_cost(length) + penalty[n])
        for n, length in zip(first_nodes, first_lengths, strict=True)
    ]
    for _ in range(horizon - 1):
        paths = [(b, cost + c + penalty[b]) for a, cost in paths for b, c in moves[a].items()]
    return min((cost + terminal[end] for end, cost in paths), default=np.inf)


def search(road_map, first_nodes, first_lengths, horizon, goal, penalty, terminal):
    """The search with the cost of this file."""
    return search_cheapest(
        road_map,
        move_table(road_map.lattice),
        np.asarray(first_nodes, dtype=np.intp),
        np.asarray(first_lengths, dtype=float),
        horizon,
        STEP_S,
        WEIGHT,
        goal,
        np.asarray(penalty, dtype=float),
        np.asarray(terminal, dtype=float),
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 4))
@example(0, 1)
@example(1, 4)
def test_the_cheapest_of_all_paths(seed, horizon):
    """Random lattices, penalties and terminal costs: exactly the least cost, by such a path."""
    generator = np.random.default_rng(seed)
    road_map = random_road_map(generator)
    count = len(road_map.nodes_m)
    # From a place at a node's cell, all nodes within a longest move: what a planner asks.
    place = road_map.nodes_m[generator.integers(count)] + generator.uniform(-0.3, 0.3, 2)
    away = np.linalg.norm(road_map.nodes_m - place, axis=1)
    first = np.flatnonzero(away <= road_map.lengths_m.max())
    first = generator.permutation(first)[: generator.integers(1, len(first) + 1)]
    penalty = generator.uniform(0.0, 3.0, count) * (generator.random(count) > 0.5)
    terminal = generator.uniform(0.0, 10.0, count)
    terminal[generator.random(count) > 0.8] = np.inf
    task = (first, away[first], horizon, int(generator.integers(count)), penalty, terminal)
    found = search(road_map, *task)
    best = brute_force(road_map, *task)
    if found is None:
        assert best == np.inf
        return
    assert found.cost_s == best
    assert found.nodes.shape == (horizon,)
    again = cost_of(road_map, found.nodes, *task[:2], *task[3:])
    assert again == pytest.approx(found.cost_s, abs=1e-12)


@pytest.mark.parametrize("horizon", [2, 3, 5])
@pytest.mark.parametrize("direction", [(2, 1), (1, 2), (-2, 1), (-1, -2), (2, 0), (0, -2)])
@pytest.mark.parametrize("spacing_m", [0.1, 0.7, 1.0 / 3.0, 0.6261, 1.7888543819998315])
def test_the_farthest_node_within_reach_is_reached(horizon, direction, spacing_m):
    """Longest moves in one line all the way, although it begins opposite the first node listed."""
    moves = horizon + 2
    half = spacing_m * (2.0 * moves + 0.5)
    road_map = small_road_map(
        bounds_m=(-half, -half, half, half), anchor_m=(0.0, 0.0), spacing_m=spacing_m
    )
    centre = np.array(road_map.lattice.shape) // 2
    dx, dy = direction
    back = int(road_map.number[centre[0] - dy, centre[1] - dx])
    ahead = int(road_map.number[centre[0] + dy, centre[1] + dx])
    target = int(road_map.number[centre[0] + horizon * dy, centre[1] + horizon * dx])
    terminal = np.full(len(road_map.nodes_m), np.inf)
    terminal[target] = 0.0
    length = spacing_m * float(np.hypot(dx, dy))
    task = ([back, ahead], [length, length], horizon, -1, np.zeros_like(terminal), terminal)
    found = search(road_map, *task)
    assert found is not None
    assert found.nodes[-1] == target
    assert found.cost_s == pytest.approx(horizon * step_cost(length))


def test_horizon_one_is_the_best_first_node():
    """With one step only the first moves count, not the lattice's."""
    road_map = random_road_map(np.random.default_rng(3), blocked=0.0)
    count = len(road_map.nodes_m)
    terminal = np.linspace(5.0, 0.0, count)
    penalty = np.zeros(count)
    penalty[11] = 100.0
    found = search(road_map, [0, 7, 11], [0.1, 1.5, 0.1], 1, -1, penalty, terminal)
    costs = {n: step_cost(x) + terminal[n] for n, x in ((0, 0.1), (7, 1.5))}
    assert found is not None
    np.testing.assert_array_equal(found.nodes, [min(costs, key=costs.get)])
    assert found.cost_s == min(costs.values())


def test_staying_at_the_goal_is_free_and_nowhere_else():
    """Once there it costs nothing more, so the horizon does not matter; elsewhere time runs."""
    road_map = random_road_map(np.random.default_rng(0), (3, 6), 0.0, 0.0)
    goal = int(road_map.number[1, 5])
    start = int(road_map.number[1, 1])
    ways = lattice_paths(road_map, goal)
    nothing = np.zeros(len(road_map.nodes_m))
    terminal = 10.0 * ways.cost_m
    costs = {}
    for horizon in (3, 4, 9):
        found = search(road_map, [start], [0.0], horizon, goal, nothing, terminal)
        assert found is not None
        assert (found.nodes[2:] == goal).all()
        costs[horizon] = found.cost_s
    assert costs[3] == costs[4] == costs[9] == pytest.approx(STEP_S + 2.0 * step_cost(1.4))
    # With the goal elsewhere, the same way costs a step's time for every step that it waits.
    found = search(road_map, [start], [0.0], 9, -1, nothing, terminal)
    assert found is not None
    assert found.cost_s > costs[9] + 3.0 * STEP_S


def test_penalties_at_the_goal_are_still_paid():
    """Staying at a goal below the bound is charged at every step, as everywhere."""
    road_map = random_road_map(np.random.default_rng(0), blocked=0.0, closed=0.0)
    goal, nothing = 5, np.zeros(12)
    penalty = nothing.copy()
    penalty[goal] = 0.25
    terminal = np.full(12, 1e9)
    terminal[goal] = 0.0
    found = search(road_map, [goal], [0.0], 4, goal, penalty, terminal)
    assert found is not None
    assert found.cost_s == pytest.approx(STEP_S + 4 * 0.25)


def test_nowhere_to_go():
    """No first node, or no node with a finite way on: None."""
    road_map = random_road_map(np.random.default_rng(0))
    count = len(road_map.nodes_m)
    nothing = np.zeros(count)
    assert search(road_map, [], [], 3, 0, nothing, nothing) is None
    assert search(road_map, [0], [0.1], 3, 0, nothing, np.full(count, np.inf)) is None
    assert search(road_map, [0], [0.1], 3, 0, np.full(count, np.inf), nothing) is None


def test_an_obstacle_that_changes_no_move_changes_nothing():
    """A second obstacle within the first, and one far off: same nodes, same cost."""
    wall = shapely.box(4.3, 0.0, 4.7, 5.2)
    plain = small_road_map(wall)
    more = small_road_map(wall, shapely.box(4.4, 1.0, 4.6, 3.0), shapely.box(30, 30, 31, 31))
    start, goal = int(plain.number[0, 1]), int(plain.number[1, 7])
    terminal = lattice_paths(plain, goal).cost_m
    nothing = np.zeros(len(terminal))
    one = search(plain, [start], [0.5], 6, goal, nothing, terminal)
    two = search(more, [start], [0.5], 6, goal, nothing, lattice_paths(more, goal).cost_m)
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.nodes, two.nodes)
    assert one.cost_s == two.cost_s
    way = shapely.LineString(plain.nodes_m[one.nodes])
    assert way.distance(wall) >= 0.1


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_costs_move_with_penalties_as_they_must(seed):
    """Dearer nodes never make it cheaper; a constant on the terminal cost only shifts the cost."""
    generator = np.random.default_rng(seed)
    road_map = random_road_map(generator)
    count = len(road_map.nodes_m)
    penalty, terminal = generator.uniform(0.0, 2.0, (2, count))
    task = ([int(road_map.number[1, 1])], [0.2], 4, 0)
    plain = search(road_map, *task, penalty, terminal)
    dearer = search(road_map, *task, penalty + generator.uniform(0.0, 1.0, count), terminal)
    shifted = search(road_map, *task, penalty, terminal + 7.0)
    assert dearer.cost_s >= plain.cost_s
    assert shifted.cost_s == pytest.approx(plain.cost_s + 7.0)
