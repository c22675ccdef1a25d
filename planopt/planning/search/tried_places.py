"""Ways to places that a robot may try: where packets may arrive, and where they are known to.

Terms that take the end of a path for a try compare many places, near ones on circles about the
robot and those known to be connected. Their ways are straight where that is clear; to the best of
the others they follow the shortest way on the lattice. On the way a packet is taken to arrive as at
the nearest of the places: only paths that are handed on are predicted themselves.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.nearest.place_tree import PlaceTree
from planopt.channel.prediction import connection_probability
from planopt.planning.baselines.baseline import free_ends, held
from planopt.planning.scene import Ground
from planopt.planning.search.taut_way import WaysFrom, stops_along
from planopt.planning.tolerances import STEP_PAD_M
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem
from planopt.world.clearance import inside_bounds

CIRCLES = (0.35, 0.7, 1.0, 1.5, 2.0, 2.5, 3.25, 4.0, 5.0, 6.0, 7.5, 9.0)
"""Radii of circles of places, in longest steps."""

FEWEST_ON_CIRCLE, APART_SHARE, LEAST_APART = 8, 1.0 / 6.0, 0.5
"""Places on a circle: as many as are this share of its radius apart, and so many longest steps at
least, but no fewer."""

MOST_KNOWN = 60
"""Of the places known to be connected within reach so many are compared, the nearest to where the
target is expected."""

MOST_HIDDEN = 12
"""Of the places that are not in sight so many are compared, those nearest to the target."""

TRIED = 4
"""Paths that are handed on, the best first."""


class TriedPlaces:
    """Finds places to try for one robot.

    Parameters
    ----------
    problem
        With one robot, and a term that tries places.
    ground
        Its geometry.
    """

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem, self._ground = problem, ground
        self._longest_m = problem.step_length_m - STEP_PAD_M
        places = [np.zeros((1, 2))]
        for number, radius in enumerate(CIRCLES):
            apart = max(LEAST_APART, radius * APART_SHARE)
            count = max(FEWEST_ON_CIRCLE, math.ceil(2.0 * math.pi * radius / apart))
            angle = 2.0 * math.pi * (np.arange(count) + 0.5 * (number % 2)) / count
            places.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        offsets = self._longest_m * np.vstack(places)
        reach_m = problem.planner.horizon * self._longest_m
        self._offsets_m = offsets[np.linalg.norm(offsets, axis=1) <= reach_m]

    def find_ways(self, situation: Situation) -> list[NDArray[np.float64]]:
        """Return the best paths (N, 2), best first."""
        places = self._places(situation)
        power = situation.power(places)
        predicted = connection_probability(
            power.mean_db, power.deviation_db, situation.thresholds_dbm[0]
        )
        seen = free_ends(self._problem, self._ground, situation.position_m, places)
        seen[0] = True
        ways = [*self._straight(situation.position_m, places[seen])]
        ways += self._round(situation, places[~seen])
        paths = np.array(ways)
        _, steps, _ = paths.shape
        beside = PlaceTree(places).nearest(paths.reshape(-1, 2), 1)[0][:, 0]
        guessed = predicted[beside].reshape(-1, steps)
        value = np.zeros(len(paths))
        for term in self._problem.terms:
            if term.tries_places:
                value += term.weight * term.tried_values(situation, paths, guessed)
        best = np.argsort(-value, kind="stable")[:TRIED]
        return [paths[i] for i in best]

    def _places(self, situation: Situation) -> NDArray[np.float64]:
        """Return the place of the robot, the others on circles, and known ones within reach."""
        here, known = situation.position_m, situation.links.connected_m
        circles = here + self._offsets_m
        reach_m = self._problem.planner.horizon * self._longest_m
        known = known[np.linalg.norm(known - here, axis=1) <= reach_m]
        target = situation.target_m
        if target is not None and len(known) > MOST_KNOWN:
            away = np.linalg.norm(known[:, None] - target, axis=2).sum(axis=1)
            known = known[np.argsort(away, kind="stable")[:MOST_KNOWN]]
        inside = inside_bounds(self._problem.workspace, circles)
        inside[0] = True
        return np.vstack([circles[inside], known])

    def _straight(
        self, here_m: NDArray[np.float64], places_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Straight ways at full speed to places (n, 2), and then standing; (n, N, 2)."""
        horizon = self._problem.planner.horizon
        away = places_m - here_m
        length = np.linalg.norm(away, axis=1)
        driven = self._longest_m * np.arange(1, horizon + 1)
        share = np.minimum(1.0, driven / np.maximum(length, 1e-12)[:, None])
        ways = here_m + share[..., None] * away[:, None]
        return np.where((share >= 1.0)[..., None], places_m[:, None], ways)

    def _round(
        self, situation: Situation, hidden_m: NDArray[np.float64]
    ) -> list[NDArray[np.float64]]:
        """Ways round obstacles to the places (n, 2) that are nearest to the target."""
        target, horizon = situation.target_m, self._problem.planner.horizon
        if not len(hidden_m) or target is None:
            return []
        away = np.linalg.norm(hidden_m - target[-1], axis=1)
        hidden_m = hidden_m[np.argsort(away, kind="stable")[:MOST_HIDDEN]]
        reach_m = horizon * self._longest_m
        ways = WaysFrom(self._problem, self._ground, situation.position_m, reach_m)
        nodes = self._ground.road_map.nodes_m
        beside = PlaceTree(nodes).nearest(hidden_m, 1)[0][:, 0]
        found: list[NDArray[np.float64]] = []
        for node in np.unique(beside[np.isfinite(ways.length_m[beside])]):
            turns = ways.turns_m(int(node), nodes[node])
            stops = stops_along(turns, self._longest_m)[1:]
            if 0 < len(stops) <= horizon:
                found.append(held(situation, list(stops)))
        return found
