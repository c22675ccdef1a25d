"""Searches beside what moves: against enumeration, and against the same without it."""

from itertools import product

import numpy as np
import pytest
from scenes import WALL, good_everywhere, search_of, small_problem

from planopt import MovingObstacle
from planopt.planning.scene import build_ground, first_moves
from planopt.planning.search.lattice_search import (
    LatticeSearch,
    MoveValues,
    MovingMoves,
    move_table,
    search_cheapest,
    steps_apart,
)
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.world import MOVES, path_distances_m, predicted_discs

CART = MovingObstacle("cart", 1.2, (0.0,), ((14.0, 13.0),), (-1.5, -1.0))
VAN = MovingObstacle("van", 0.7, (0.0,), ((8.0, 12.0),), (1.0, 0.3))
AT = np.array([10.3, 10.2])


def searched(horizon, discs, move_value, seed=0):
    """A search over random rewards beside discs."""
    ground = build_ground(small_problem(WALL), np.array([5.0, 15.0]))
    lattice, road_map = ground.road_map.lattice, ground.road_map
    rewards = np.random.default_rng(seed).normal(size=(horizon, *lattice.shape))
    rewards[:, ~lattice.free] = -np.inf
    nodes, _ = first_moves(ground, small_problem(WALL), AT)
    ends = road_map.nodes_m[nodes]
    nodes = nodes[steps_apart(discs, 0, np.broadcast_to(AT, ends.shape), ends)]
    first = np.stack([road_map.rows[nodes], road_map.columns[nodes]], axis=1)
    moving = MovingMoves(lattice, discs) if len(discs) else None
    moves = MoveValues(move_table(lattice), move_value, moving=moving)
    search = LatticeSearch(moves, first, np.zeros(len(first)), horizon)
    found = search(lambda k, window: rewards[k - 1][window])
    return found, rewards, road_map, nodes


def discs_of(*obstacles, horizon, clearance=0.5):
    return predicted_discs(obstacles, 0.0, 1.0, horizon, clearance)


@pytest.mark.parametrize("cost", [0.0, 0.2])
def test_value_is_that_of_enumeration(cost):
    """Three steps, all of them tried, every one against both discs by the distance itself."""
    discs = discs_of(CART, VAN, horizon=3)
    move_value = -cost * np.random.default_rng(5).random(len(MOVES))
    found, rewards, road_map, nodes = searched(3, discs, move_value)
    open_moves = road_map.lattice.open_moves
    best, blocked = -np.inf, 0
    for node, moves in product(nodes, product(range(len(MOVES)), repeat=2)):
        row, column = road_map.rows[node], road_map.columns[node]
        gained, path = rewards[0][row, column], [AT, road_map.nodes_m[node]]
        for k, move in enumerate(moves, start=1):
            if not open_moves[move, row, column]:
                break
            row, column = row + MOVES[move][1], column + MOVES[move][0]
            gained += rewards[k][row, column] + move_value[move]
            path.append(road_map.nodes_m[road_map.number[row, column]])
        else:
            away = path_distances_m(discs, np.array(path)) - discs.apart_m
            if (away >= CLEARANCE_PAD_M).all():
                best = max(best, gained)
            else:
                blocked += 1
    assert blocked > 100
    assert found.values[-1].max() == pytest.approx(best, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("cost", [0.0, 0.2])
def test_paths_keep_apart_and_are_worth_their_value(seed, cost):
    """The path found back is one that was valued."""
    horizon = 8
    discs = discs_of(CART, VAN, horizon=horizon)
    move_value = np.full(len(MOVES), -cost)
    found, rewards, road_map, _ = searched(horizon, discs, move_value, seed)
    path = found.best_path()
    gained = rewards[np.arange(horizon), path[:, 0], path[:, 1]].sum() - cost * (horizon - 1)
    assert gained == pytest.approx(found.values[-1].max())
    places = road_map.nodes_m[road_map.number[path[:, 0], path[:, 1]]]
    away = path_distances_m(discs, np.vstack([AT, places])) - discs.apart_m
    assert away.min() >= CLEARANCE_PAD_M


@pytest.mark.parametrize("horizon", [3, 6])
def test_cheapest_path_to_a_goal_against_enumeration_by_stages(horizon):
    """Bellman's equation node by node, moves tested one by one."""
    problem = small_problem(WALL, horizon=horizon)
    search, _, scene = search_of(problem, good_everywhere)
    del search
    road_map, discs = scene.road_map, discs_of(CART, VAN, horizon=horizon)
    nodes, lengths = first_moves(scene, problem, AT)
    ends = road_map.nodes_m[nodes]
    kept = steps_apart(discs, 0, np.broadcast_to(AT, ends.shape), ends)
    nodes, lengths = nodes[kept], lengths[kept]
    terminal = scene.cost_to_go.cost_m
    none = np.zeros(len(road_map.nodes_m))
    steps = nodes, lengths, horizon, 1.0, 0.1
    table, goal = move_table(road_map.lattice), scene.goal_node
    found = search_cheapest(road_map, table, *steps, goal, none, terminal, None, discs)
    assert found is not None
    cost = dict(zip(nodes.tolist(), (1.0 + 0.1 * lengths**2).tolist(), strict=True))
    for k in range(1, horizon):
        following: dict[int, float] = {}
        for node in range(len(road_map.nodes_m)):
            for move, source in enumerate(road_map.sources[node].tolist()):
                if source not in cost:
                    continue
                ways = road_map.nodes_m[[source]], road_map.nodes_m[[node]]
                if not steps_apart(discs, k, *ways)[0]:
                    continue
                total = cost[source] + 1.0 + 0.1 * road_map.lengths_m[move] ** 2
                following[node] = min(total, following.get(node, np.inf))
        cost = following
    path = np.vstack([AT, road_map.nodes_m[found]])
    legs = np.linalg.norm(np.diff(path, axis=0), axis=1)
    total = (1.0 + 0.1 * legs**2).sum() + terminal[found[-1]]
    assert total == pytest.approx(min(c + terminal[n] for n, c in cost.items()))
    assert (path_distances_m(discs, path) - discs.apart_m).min() >= CLEARANCE_PAD_M
