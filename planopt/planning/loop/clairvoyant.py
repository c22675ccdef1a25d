"""What a run to a goal cost in truth, and what it costs one who knows the mean power everywhere.

A step costs its length, and the outage price for its length besides where its end is truly out of
contact. The clairvoyant drives the cheapest path on the true power without small-scale fading, and
is charged by the same fading as the robot: nobody can know that beforehand. It knows as well that
only the ends of steps are charged, so that it may step from island to island.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.serving_power import serving_power_dbm
from planopt.channel.fields.truth import Truth, mean_power_dbm
from planopt.planning.loop.log import Outcome
from planopt.planning.loop.true_serving import true_serving_dbm
from planopt.planning.roads import node_at, nodes_in_reach
from planopt.planning.robot_problem import problem_of_robot
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, index_obstacles, segments_clear
from planopt.world.road_map import RoadMap, shortest_ways, way_from

SHORTCUT_NODES = 40
"""A straight stretch of the clairvoyant's path skips at most so many nodes of the lattice."""
SAMPLES = 16
"""Places at which a stretch is looked at."""


COSTS = ("realised_cost_m", "clairvoyant_cost_m", "cost_ratio")
"""Metrics of :func:`run_costs`."""


def run_costs(
    problem: Problem,
    road_maps: Sequence[RoadMap],
    truths: Sequence[Truth],
    tracks_m: Sequence[NDArray[np.float64]],
    outcome: Outcome,
) -> dict[str, float]:
    """Return the costs of a run to goals: driven, a clairvoyant's, and their ratio, by metric.

    Costs are sums over all robots; each robot's clairvoyant is alone. The ratio is NaN for a run
    that did not arrive.

    Parameters
    ----------
    problem, truths
        What was run, and each station's channel.
    road_maps
        Lattice of each robot with a node at its goal; none where there are no goals.
    tracks_m
        ``(n + 1, 2)`` places of each robot.
    outcome
        Of the run.
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
    """Length of a driven path (n + 1, 2), steps truly out of contact at the outage price."""
    lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    power = true_serving_dbm(problem, truths, places_m[1:])
    outside = power < problem.stations[0].threshold_dbm
    return float(lengths.sum() + problem.reach.outage_price * lengths[outside].sum())


def clairvoyant_path(
    problem: Problem,
    road_map: RoadMap,
    index: ObstacleIndex,
    truths: Sequence[Truth],
) -> NDArray[np.float64]:
    """Places (n + 1, 2) after each step of the cheapest path from the robot's start to its goal.

    Parameters
    ----------
    problem
        The problem, with a path from its start to its goal.
    road_map, index
        Its lattice with a node at the goal, and its obstacles.
    truths
        Each station's.
    """
    start = np.asarray(problem.robots[0].start_m, dtype=np.float64)
    metre_cost = _metre_cost(problem, truths, road_map.nodes_m)
    goal = node_at(road_map, np.asarray(problem.goal_m))
    ways = shortest_ways(road_map, goal, metre_cost)
    nodes, lengths = nodes_in_reach(road_map, index, problem, start)
    here = float(_metre_cost(problem, truths, start[None])[0])
    joining = 0.5 * lengths * (here + metre_cost[nodes])
    first = int(nodes[np.argmin(joining + ways.cost_m[nodes])])
    places = np.vstack([start, road_map.nodes_m[way_from(road_map, ways, first, np.inf)]])
    # A move of the lattice is a step; straight stretches are shorter, but end steps elsewhere.
    straight = _in_steps(problem, _straightened(problem, index, truths, places))
    return min((places, straight), key=lambda path: _cost_of_steps_m(problem, truths, path))


def _in_steps(problem: Problem, turns_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (n + 1, 2) after each of the longest steps along a path of turns (k, 2)."""
    legs = np.linalg.norm(np.diff(turns_m, axis=0), axis=1)
    driven = np.concatenate([[0.0], legs.cumsum()])
    stops = np.append(np.arange(0.0, driven[-1], problem.step_length_m), driven[-1])
    return np.stack([np.interp(stops, driven, turns_m[:, axis]) for axis in (0, 1)], axis=1)


def _cost_of_steps_m(
    problem: Problem, truths: Sequence[Truth], places_m: NDArray[np.float64]
) -> float:
    """Cost of steps (n + 1, 2) without fading, each charged by its end."""
    lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    return float(lengths @ _metre_cost(problem, truths, places_m[1:]))


def _metre_cost(
    problem: Problem, truths: Sequence[Truth], places_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What a metre truly costs at places (n, 2) without fading."""
    powers = np.stack([mean_power_dbm(truth, places_m) for truth in truths])
    thresholds = [radio.threshold_dbm for radio in problem.stations]
    outside = serving_power_dbm(powers, thresholds) < thresholds[0]
    return np.where(outside, 1.0 + problem.reach.outage_price, 1.0)


def _straightened(
    problem: Problem, index: ObstacleIndex, truths: Sequence[Truth], places_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The cheapest path over some of a path's places (n, 2), straight and clear between them."""
    count = len(places_m)
    first, second = np.triu_indices(count, 1)
    near = second - first <= SHORTCUT_NODES
    first, second = first[near], second[near]
    wanted = problem.constraints.clearance_m
    clear = segments_clear(index, places_m[first], places_m[second], wanted)
    # The lattice's own moves are clear already.
    clear |= second == first + 1
    first, second = first[clear], second[clear]
    share = (np.arange(SAMPLES) + 0.5)[:, None, None] / SAMPLES
    samples = places_m[first] + share * (places_m[second] - places_m[first])
    each = _metre_cost(problem, truths, samples.reshape(-1, 2)).reshape(SAMPLES, -1)
    cost = np.linalg.norm(places_m[second] - places_m[first], axis=1) * each.mean(axis=0)
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
