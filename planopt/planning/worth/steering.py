"""The outer layer of the two-layer form: the place that the robot is steered to, and the way there.

The place q* has the highest J_CH = max{0, sigma^2 - sigma_TH^2} psi(d) of those that stand for the
workspace, with d the length of the shortest way to it. Variances come from a map that follows the
belief, so that the cost does not grow with the measurements.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.maps.tile_map import TileMap
from planopt.channel.nearest.place_tree import PlaceTree
from planopt.planning.ground import Ground
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.search.taut_way import WaysFrom
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.planning.worth.region import workspace_region
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.steering_way import SteeringWay, steering_way
from planopt.problems.objective import MappingTerm
from planopt.problems.problem import Problem
from planopt.world.clearance import segments_clear
from planopt.world.road_map import shortest_ways

TILE = 1
"""Places of the region are far apart: each has its own neighbours."""

NEIGHBOURS = 48
"""Measurements that each place is conditioned on."""


class Steering:
    """Finds where to steer to; keeps its map of the channel.

    Parameters
    ----------
    problem
        With one robot.
    ground
        Its geometry.
    term
        Threshold and decay of J_CH.
    """

    def __init__(self, problem: Problem, ground: Ground, term: MappingTerm) -> None:
        self._problem, self._ground, self._term = problem, ground, term
        places = workspace_region(problem).grid_m
        x, column = np.unique(places[:, 0], return_inverse=True)
        y, row = np.unique(places[:, 1], return_inverse=True)
        needed = np.zeros((len(y), len(x)), dtype=bool)
        needed[row, column] = True
        self._places_m = places
        self._at = row, column
        self._map = TileMap(x, y, needed, TILE, NEIGHBOURS)
        nodes = ground.road_map.nodes_m
        self._nearest = PlaceTree(nodes).nearest(places, 1)[0][:, 0]
        beside = nodes[self._nearest]
        # A place too near to an obstacle is never come to.
        wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
        clear = segments_clear(ground.index, beside, places, wanted)
        away: NDArray[np.float64] = np.linalg.norm(beside - places, axis=1)
        self._beside_m = np.where(clear, away, np.inf)

    def find_way(self, situation: Situation) -> SteeringWay | None:
        """The way to steer along; None if no place that can be come to is above the threshold.

        Parameters
        ----------
        situation
            The belief of the channel, and where the robot is.
        """
        (own,), (posterior,) = situation.stations, situation.anticipated
        if posterior is own:
            self._map.refresh(own)
            variance = self._map.deviation_db[self._at] ** 2
        else:
            # What the others will have measured changes every step: no map keeps up with it.
            variance = search_prediction(posterior, self._places_m).deviation_db ** 2
        above = variance - self._term.variance_threshold_db2
        is_open = situation.measuring.is_open(self._places_m)
        counted = np.where(is_open, np.maximum(above, 0.0), 0.0)
        return self.way_to_best(counted, situation.position_m)

    def way_to_best(
        self, above_db2: NDArray[np.float64], position_m: NDArray[np.float64]
    ) -> SteeringWay | None:
        """The way to the place of the largest J_CH, of places that much above the threshold."""
        ways = WaysFrom(self._problem, self._ground, position_m)
        distance = ways.length_m[self._nearest] + self._beside_m
        reachable = np.isfinite(distance)
        straight = np.linalg.norm(self._places_m - position_m, axis=1)
        distance = np.where(ways.straight(self._places_m), straight, distance)
        worth = np.zeros_like(above_db2)
        nearness = np.exp(-self._term.closeness_per_m * distance[reachable])
        worth[reachable] = above_db2[reachable] * nearness
        best = int(worth.argmax())
        if worth[best] == 0.0:
            return None
        road_map, node = self._ground.road_map, int(self._nearest[best])
        lengths = shortest_ways(road_map, node).cost_m + self._beside_m[best]
        # Nodes that cannot be come to are as far as the farthest: no search looks at them.
        farthest = float(lengths[np.isfinite(lengths)].max())
        lattice = np.full(road_map.lattice.shape, farthest)
        lattice[road_map.rows, road_map.columns] = np.minimum(lengths, farthest)
        turns = ways.turns_m(node, self._places_m[best])
        return steering_way(self._problem, self._ground.index, turns, lattice)
