"""The lattice search against enumeration, and against a dynamic programme by nodes."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scenes import CUP, WALL, small_problem

from planopt.planning.scene import build_ground, first_moves
from planopt.planning.search.lattice_search import (
    REACH,
    LatticeSearch,
    MoveValues,
    move_table,
    search_cheapest,
)
from planopt.world import MOVES, Lattice, build_road_map, lattice_paths

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
    positions = 0.7 * np.moveaxis(np.indices(shape)[::-1], 0, -1)
    moved = np.zeros((0, 2), dtype=np.intp)
    return build_road_map(Lattice(np.zeros(2), 0.7, shape, free, opened, positions, moved))


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
    """The nodes found and their cost by this file; None if there are none."""
    nodes = search_cheapest(
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
    if nodes is None:
        return None
    cost = cost_of(road_map, nodes, first_nodes, first_lengths, goal, penalty, terminal)
    return SimpleNamespace(nodes=nodes, cost_s=cost)


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
    assert found.cost_s == pytest.approx(best, abs=1e-12)
    assert found.nodes.shape == (horizon,)


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


def rewarded(polygon, horizon, start=(10.3, 10.2), seed=0, move_value=None):
    """A search over random rewards, the rewards (N, ny, nx), the ground and its first nodes."""
    problem = small_problem(polygon)
    ground = build_ground(problem, np.asarray(problem.robots[0].start_m))
    lattice = ground.road_map.lattice
    rewards = np.random.default_rng(seed).normal(size=(horizon, *lattice.shape))
    rewards[:, ~lattice.free] = -np.inf
    nodes, _ = first_moves(ground, problem, np.asarray(start))
    first = np.stack([ground.road_map.rows[nodes], ground.road_map.columns[nodes]], axis=1)
    worth = np.zeros(len(MOVES)) if move_value is None else move_value
    moves = MoveValues(move_table(lattice), worth)
    search = LatticeSearch(moves, first, np.zeros(len(first)), horizon)
    found = search(lambda k, window: rewards[k - 1][window])
    return found, rewards, ground, nodes


def value_by_nodes(rewards, ground, nodes, move_value):
    """The best value of every node by the road map's table of sources."""
    rows, columns = ground.road_map.rows, ground.road_map.columns
    value = np.full(len(rows) + 1, -np.inf)
    value[nodes] = rewards[0][rows[nodes], columns[nodes]]
    for reward in rewards[1:]:
        arriving = value[ground.road_map.sources] + move_value
        value = np.append(arriving.max(axis=1) + reward[rows, columns], -np.inf)
    return value[:-1]


@pytest.mark.parametrize("polygon", [WALL, CUP])
@pytest.mark.parametrize("horizon", [1, 2, 7, 25])
@pytest.mark.parametrize("cost", [0.0, 0.1])
def test_value_is_that_of_a_search_by_nodes(polygon, horizon, cost):
    """Every node's value, the best one, and a path that adds up to it; moves cost or not."""
    move_value = -cost * np.random.default_rng(5).random(len(MOVES))
    found, rewards, ground, nodes = rewarded(polygon, horizon, move_value=move_value)
    expected = value_by_nodes(rewards, ground, nodes, move_value)
    by_node = np.full(ground.road_map.lattice.shape, -np.inf)
    by_node[ground.road_map.rows, ground.road_map.columns] = expected
    rows, columns = (slice(part.start - REACH, part.stop - REACH) for part in found.windows[-1])
    np.testing.assert_allclose(found.values[-1], by_node[rows, columns], atol=1e-12)
    by_node[rows, columns] = -np.inf
    assert not np.isfinite(by_node).any()
    path = found.best_path()
    gained = rewards[np.arange(horizon), path[:, 0], path[:, 1]].sum()
    moves = np.diff(path, axis=0)[:, ::-1]
    gained += sum(move_value[(np.asarray(MOVES) == move).all(axis=1)].item() for move in moves)
    assert gained == pytest.approx(expected.max(), abs=1e-12)
    number = ground.road_map.number[path[:, 0], path[:, 1]]
    assert number[0] in nodes
    for before, after in pairwise(number):
        assert before in ground.road_map.sources[after]


def test_rewards_that_forbid_everything_leave_no_end():
    found, rewards, _, _ = rewarded(WALL, 4)
    assert found.best_path() is not None
    assert rewards.shape[0] == 4
    nothing, *_ = rewarded(WALL, 4, move_value=np.full(len(MOVES), -np.inf))
    assert nothing.best_path() is None
