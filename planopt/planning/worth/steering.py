"""The outer layer of the seed's (3): where the robot is steered to, and by which way.

q* is the place of the highest J_CH = max{0, sigma^2 - sigma_TH^2} psi(d) among the places that
stand for the workspace. Their variances come from a map that follows the belief, so that the cost
does not grow with the measurements. Steered straight to q*, a robot wedges itself in front of
obstacles (experiments D); with geodesic steering d is the length of the shortest way round them,
and the robot is steered to the point of this way that it can come to.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.maps.tile_map import TileMap
from planopt.channel.nearest.place_tree import PlaceTree
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.ground import Ground, first_moves
from planopt.planning.worth.region import workspace_region
from planopt.problems.objective import MappingTerm
from planopt.problems.problem import Problem
from planopt.world.road_map import shortest_ways, way_from

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
    geodesic
        Go round obstacles; else straight, as the seed does.
    """

    def __init__(
        self, problem: Problem, ground: Ground, term: MappingTerm, geodesic: bool = True
    ) -> None:
        self._problem, self._ground = problem, ground
        self._term, self._geodesic = term, geodesic
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
        self._beside_m = np.linalg.norm(nodes[self._nearest] - places, axis=1)

    def find_place(
        self, posterior: ChannelPosterior, position_m: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Where to steer to (2,); None where no place that can be come to is above the threshold.

        Parameters
        ----------
        posterior
            What is believed of the channel.
        position_m
            ``(2,)`` where the robot is.
        """
        self._map.refresh(posterior)
        variance = self._map.deviation_db[self._at] ** 2
        above = np.maximum(variance - self._term.variance_threshold_db2, 0.0)
        # Where power is measured, it is known.
        spacing = self._problem.channel.measure_spacing_m
        above[nearest_measured_m(posterior, self._places_m) < spacing] = 0.0
        if not self._geodesic:
            distance = np.linalg.norm(self._places_m - position_m, axis=1)
            best = self._best(above, distance)
            return None if best is None else self._places_m[best]
        return self._round_obstacles(above, position_m)

    def _best(self, above: NDArray[np.float64], distance_m: NDArray[np.float64]) -> int | None:
        reachable = np.isfinite(distance_m)
        worth = np.zeros_like(above)
        nearness = np.exp(-self._term.closeness_per_m * distance_m[reachable])
        worth[reachable] = above[reachable] * nearness
        best = int(worth.argmax())
        return best if worth[best] > 0.0 else None

    def _round_obstacles(
        self, above: NDArray[np.float64], position_m: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """The farthest point of the way to q* that the plan's steps come to."""
        road_map = self._ground.road_map
        nodes, lengths = first_moves(self._ground, self._problem, position_m)
        if not len(nodes):
            return None
        here = int(np.argmin(lengths))
        ways = shortest_ways(road_map, int(nodes[here]))
        distance = lengths[here] + ways.cost_m[self._nearest] + self._beside_m
        best = self._best(above, distance)
        if best is None:
            return None
        reach = self._problem.step_length_m * self._problem.planner.horizon
        if distance[best] <= reach:
            return self._places_m[best]
        way = road_map.nodes_m[way_from(road_map, ways, int(self._nearest[best]), math.inf)[::-1]]
        legs = np.linalg.norm(np.diff(np.vstack([position_m, way]), axis=0), axis=1)
        within = np.flatnonzero(np.cumsum(legs) <= reach)
        return way[int(within[-1])] if len(within) else way[0]


def nearest_measured_m(
    posterior: ChannelPosterior, places_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How far each place (n, 2) is from the nearest measurement, infinite without any; (n,)."""
    measured = posterior.measurements.positions_m
    if not len(measured):
        return np.full(len(places_m), np.inf)
    nearest = posterior.index.nearest(places_m, 1)[0][:, 0]
    return np.linalg.norm(measured[nearest] - places_m, axis=1)
