"""The search for the most rewarding path against enumeration and a dynamic programme by nodes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scenes import CUP, WALL, small_problem

from planopt.planning.scene import build_ground, first_moves
from planopt.planning.search.lattice_search import REACH, LatticeSearch, MoveValues, move_table
from planopt.world.lattice import MOVES


def searched(polygon, horizon, start=(10.3, 10.2), seed=0, move_value=None):
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
    found, rewards, ground, nodes = searched(polygon, horizon, move_value=move_value)
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
    """No finite value, no end."""
    found, rewards, _, _ = searched(WALL, 4)
    assert found.best_path() is not None
    assert rewards.shape[0] == 4
    nothing, *_ = searched(WALL, 4, move_value=np.full(len(MOVES), -np.inf))
    assert nothing.best_path() is None
