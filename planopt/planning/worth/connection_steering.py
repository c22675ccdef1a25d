"""Where a robot out of contact is steered to: the place that makes for the shortest search.

A search that begins with a try at the place z is expected to take R(z) metres
(:func:`planopt.objectives.until_connected.search_length_m`), which is short where z is near and
where it is likely to be connected. The robot is steered to the place of the shortest search, of
those that are tries (:attr:`planopt.planning.worth.situation.Situation.tries`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import connection_probability
from planopt.objectives.measuring import OPEN_SPACINGS
from planopt.planning.ground import Ground
from planopt.planning.search.lattice_map import LatticeMap
from planopt.planning.search.taut_way import WaysFrom
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.steering_way import SteeringWay, steering_way
from planopt.problems.objective import UntilConnectedTerm
from planopt.problems.problem import Problem

FIRST_RADIUS_STEPS, WIDER = 16.0, 2.0
"""Places are first looked at within so many longest steps of way, and then within `WIDER` times
that, until no search beyond can be shorter than the best within. The next step begins with what
sufficed."""


class ConnectionSteering:
    """Finds where to steer to for a connection; keeps its map of the channel.

    Parameters
    ----------
    problem
        With one robot.
    ground
        Its geometry.
    term
        The term that searches for connection.
    """

    def __init__(self, problem: Problem, ground: Ground, term: UntilConnectedTerm) -> None:
        self._problem, self._ground, self._term = problem, ground, term
        self._map = LatticeMap(ground.road_map.lattice)
        self._radius_m = FIRST_RADIUS_STEPS * problem.step_length_m

    def find_way(self, situation: Situation) -> SteeringWay | None:
        """Return the way to the place of the shortest search; None if no place can be tried.

        Parameters
        ----------
        situation
            What is known; how it is steered is not looked at.
        """
        road_map, here = self._ground.road_map, situation.position_m
        widest = situation.workspace_diagonal_m
        rule = situation.tries
        rule = replace(rule, spacing_m=OPEN_SPACINGS * rule.spacing_m)
        while True:
            radius = self._radius_m
            last = radius >= widest
            ways = WaysFrom(self._problem, self._ground, here, math.inf if last else radius)
            near = np.flatnonzero(np.isfinite(ways.length_m))
            near = near[rule.is_open(road_map.nodes_m[near])]
            if len(near):
                chance = self._chance(situation, near, radius)
                length = self._term.search_length_m(situation, ways.length_m[near], chance)
                best = int(length.argmin())
                if last or length[best] <= radius:
                    node = int(near[best])
                    turns = ways.turns_m(node, road_map.nodes_m[node])
                    return steering_way(self._problem, self._ground.index, turns)
            elif last:
                return None
            self._radius_m *= WIDER

    def _chance(
        self, situation: Situation, nodes: NDArray[np.intp], radius_m: float
    ) -> NDArray[np.float64]:
        """Chance of a connection at some nodes within `radius_m` of the robot; ``(k,)``."""
        low, high = situation.position_m - radius_m, situation.position_m + radius_m
        window = float(low[0]), float(low[1]), float(high[0]), float(high[1])
        self._map.refresh(situation.posterior, situation.circumstances.broad, window)
        at = self._ground.road_map.rows[nodes], self._ground.road_map.columns[nodes]
        threshold = self._problem.stations[0].threshold_dbm
        mean, deviation = self._map.mean_db[at], self._map.deviation_db[at]
        return connection_probability(mean, deviation, threshold)
