"""The way to a place that is left to measure, for plans that reach none.

Where the spacing is longer than what a plan drives, or a robot is in the middle of what it has
measured, no plan brings a measurement and all are worth nothing. Then the robot takes a short way
out, to where a step brings most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.nearest.place_index import PlaceTree
from planopt.planning.scene import Ground
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.search.taut_way import WaysFrom, stops_along
from planopt.planning.tolerances import STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.planning.values.exploration import left_to_learn

STEPS_MORE = 2
"""Places that so many more steps lead to than to the nearest are compared with it."""


def way_to_unmeasured(situation: StepContext, ground: Ground) -> NDArray[np.float64] | None:
    """The first N steps of the way there, (N, 2), standing where it ends; None if none is left."""
    problem, here = situation.problem, situation.position_m
    lattice, nodes = ground.road_map.lattice, ground.road_map.nodes_m
    left = left_to_learn(problem, ground.index, lattice, here, situation.anticipated)
    if not len(left):
        return None
    ways = WaysFrom(problem, ground, here)
    beside = PlaceTree(nodes).nearest(left, 1)[0][:, 0]
    longest = problem.step_length_m - STEP_PAD_M
    steps = _steps(ways, left, here, beside, nodes, longest)
    near = np.flatnonzero(steps <= steps.min() + STEPS_MORE)
    if not np.isfinite(steps[near]).all():
        return None
    single = left[near][:, None]
    best = int(near[(LocalRanking(situation, single)(single) / steps[near]).argmax()])
    stops = stops_along(ways.turns_m(int(beside[best]), left[best]), longest)[1:]
    horizon = problem.planner.horizon
    return np.concatenate([stops, np.repeat(stops[-1:], horizon, axis=0)])[:horizon]


def _steps(
    ways: WaysFrom,
    places_m: NDArray[np.float64],
    here_m: NDArray[np.float64],
    beside: NDArray[np.intp],
    nodes_m: NDArray[np.float64],
    longest_m: float,
) -> NDArray[np.float64]:
    """Return how many steps it is to each place (n, 2), straight or by the node beside it; (n,)."""
    aside: NDArray[np.float64] = np.linalg.norm(nodes_m[beside] - places_m, axis=1)
    straight: NDArray[np.float64] = np.linalg.norm(places_m - here_m, axis=1)
    length = np.where(ways.straight(places_m), straight, ways.length_m[beside] + aside)
    return np.maximum(np.ceil(length / longest_m), 1.0)
