"""Realised cost of a run to a goal, and cost of a clairvoyant planner with known mean power.

A path costs its length plus the outage price for each metre truly out of contact. The clairvoyant
plans on the true power without small-scale fading, which is unpredictable, but its cost includes
fading, like the robot's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity_law import serving_power_dbm
from planopt.channel.ground_truth import Truth, mean_power_dbm
from planopt.planning.free_space import node_at, nodes_in_reach
from planopt.planning.loop.log import Outcome
from planopt.planning.loop.metrics import COSTS, true_serving_dbm
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.clearance import ObstacleIndex, index_obstacles, segments_clear
from planopt.world.lattice import RoadMap, cheapest_paths, route_from

SHORTCUT_NODES = 40
"""Maximum number of lattice nodes that a straight segment of the clairvoyant's path may skip."""
COST_CELLS = 0.1
"""Sampling interval of costs, in cells of the true map."""
SEARCHED_CELLS = 0.5
"""Sampling interval in the clairvoyant's search, in cells."""

IsOut = Callable[[NDArray[np.float64]], NDArray[np.bool_]]
"""Function from positions (n, 2) to a mask (n,) of those out of contact."""


def run_costs(
    problem: Problem,
    road_maps: Sequence[RoadMap],
    truths: Sequence[Truth],
    tracks_m: Sequence[NDArray[np.float64]],  # (n + 1, 2) positions of each robot
    outcome: Outcome,
) -> dict[str, float]:
    """Return the total costs of a run to goals and of the clairvoyants, and their ratio.

    Each clairvoyant ignores the other robots; the ratio is NaN for runs that did not arrive.
    """
    if not road_maps:
        return {}
    index = index_obstacles(problem.workspace)
    driven = least = 0.0
    for number, (road_map, track) in enumerate(zip(road_maps, tracks_m, strict=True)):
        own = problem_of_robot(problem, number)
        path = clairvoyant_path(own, road_map, index, truths)
        driven += realised_cost_m(own, truths, track)
        least += realised_cost_m(own, truths, path)
    arrived = outcome is Outcome.REACHED and least > 0.0
    ratio = driven / least if arrived else float("nan")
    return dict(zip(COSTS, (driven, least, ratio), strict=True))


def realised_cost_m(
    problem: Problem, truths: Sequence[Truth], places_m: NDArray[np.float64]
) -> float:
    """Return the length of a path (n + 1, 2) plus the outage price of its metres out of contact."""

    def is_out(places: NDArray[np.float64]) -> NDArray[np.bool_]:
        return true_serving_dbm(problem, truths, places) < problem.stations[0].true_threshold_dbm

    spacing = COST_CELLS * _cell_m(truths)
    return float(_costs_m(problem, is_out, places_m[:-1], places_m[1:], spacing).sum())


def clairvoyant_path(
    problem: Problem,
    road_map: RoadMap,
    index: ObstacleIndex,
    truths: Sequence[Truth],
) -> NDArray[np.float64]:
    """Return the waypoints (k, 2) of the cheapest path from the robot's start to its goal."""
    thresholds = [radio.true_threshold_dbm for radio in problem.stations]

    def is_out(places: NDArray[np.float64]) -> NDArray[np.bool_]:
        powers = np.stack([mean_power_dbm(truth, places) for truth in truths])
        return serving_power_dbm(powers, thresholds) < thresholds[0]

    def cost_m(begins: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
        return _costs_m(problem, is_out, begins, ends, SEARCHED_CELLS * _cell_m(truths))

    nodes_m = road_map.nodes_m
    moves = cost_m(nodes_m[road_map.edge_from], nodes_m[road_map.edge_to])
    paths = cheapest_paths(road_map, node_at(road_map, np.asarray(problem.goal_m)), moves)
    start = np.asarray(problem.robots[0].start_m, dtype=np.float64)
    nodes, _ = nodes_in_reach(road_map, index, problem, start)
    joining = cost_m(np.broadcast_to(start, (len(nodes), 2)), nodes_m[nodes])
    first = int(nodes[np.argmin(joining + paths.cost_m[nodes])])
    places = np.vstack([start, nodes_m[route_from(road_map, paths, first, np.inf)]])
    return _straightened(problem, index, places, cost_m)


def _cell_m(truths: Sequence[Truth]) -> float:
    """Return the smallest cell side of the true maps."""
    return min(min(truth.raster.cell_m) for truth in truths)


def _costs_m(
    problem: Problem,
    is_out: IsOut,
    begins_m: NDArray[np.float64],
    ends_m: NDArray[np.float64],
    spacing_m: float,
) -> NDArray[np.float64]:
    """Return the costs (n,) of straight segments, sampled at intervals of `spacing_m`."""
    lengths = np.linalg.norm(ends_m - begins_m, axis=1)
    counts = np.maximum(np.ceil(lengths / spacing_m), 1.0).astype(np.intp)
    owner = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(owner)) - np.repeat(counts.cumsum() - counts, counts)
    along = ((number + 0.5) / counts[owner])[:, None]
    out = is_out(begins_m[owner] + along * (ends_m - begins_m)[owner])
    share = np.bincount(owner, weights=out, minlength=len(counts)) / counts
    return lengths * (1.0 + problem.reach.outage_price * share)


def _straightened(
    problem: Problem,
    index: ObstacleIndex,
    places_m: NDArray[np.float64],
    cost_m: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return the cheapest collision-free path through a subset of a path's points (n, 2)."""
    count = len(places_m)
    first, second = np.triu_indices(count, 1)
    near = second - first <= SHORTCUT_NODES
    first, second = first[near], second[near]
    wanted = problem.constraints.clearance_m
    clear = segments_clear(index, places_m[first], places_m[second], wanted)
    # Moves of the lattice are collision-free by construction.
    clear |= second == first + 1
    first, second = first[clear], second[clear]
    cost = cost_m(places_m[first], places_m[second])
    best, came = np.full(count, np.inf), np.zeros(count, dtype=np.intp)
    best[0] = 0.0
    for k in range(1, count):
        arriving = np.flatnonzero(second == k)
        total = best[first[arriving]] + cost[arriving]
        chosen = int(np.argmin(total))
        best[k], came[k] = total[chosen], first[arriving[chosen]]
    path = [count - 1]
    while path[-1] > 0:
        path.append(int(came[path[-1]]))
    return places_m[path[::-1]]
