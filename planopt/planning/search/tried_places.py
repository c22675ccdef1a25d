"""Ways to places that a robot may try: where packets may arrive, and where they are known to.

Terms that take the end of a path for a try compare many places, near ones on circles about the
robot and those known to be connected. Their ways are straight where that is clear; to the best of
the others they follow the shortest way on the lattice.

Power is that of the nearest node of the lattice at first, which costs the same whatever was
measured. Only the ends of the best ways are predicted themselves; on the way, a packet is taken to
arrive as at the node. What is handed on is valued again by all measurements.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planopt.channel.nearest.place_index import PlaceTree
from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.baselines.baseline import free_ends, held
from planopt.planning.scene import Ground
from planopt.planning.search.node_margins import NodeField
from planopt.planning.search.taut_way import WaysFrom, stops_along
from planopt.planning.tolerances import STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.planning.values.objective_value import tried_worth
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

COMPARED = 12
"""The ends of so many ways are predicted themselves, those that are best by the lattice."""

TRIED = 4
"""Paths that are handed on, the best first."""


class TriedPlaces:
    """Finds places to try for one robot."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem, self._ground = problem, ground
        self._longest_m = problem.step_length_m - STEP_PAD_M
        self._alone = len(problem.terms) == 1 and not problem.constraints.asks_connection
        places = [np.zeros((1, 2))]
        for number, radius in enumerate(CIRCLES):
            apart = max(LEAST_APART, radius * APART_SHARE)
            count = max(FEWEST_ON_CIRCLE, math.ceil(2.0 * math.pi * radius / apart))
            angle = 2.0 * math.pi * (np.arange(count) + 0.5 * (number % 2)) / count
            places.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        offsets = self._longest_m * np.vstack(places)
        reach_m = problem.planner.horizon * self._longest_m
        self._offsets_m = offsets[np.linalg.norm(offsets, axis=1) <= reach_m]

    def find_ways(self, situation: StepContext, field: NodeField) -> list[NDArray[np.float64]]:
        """Return the best paths (N, 2), best first."""
        places = self._places(situation)
        seen = free_ends(self._problem, self._ground, situation.position_m, places)
        seen[0] = True
        ways = [*self._straight(situation.position_m, places[seen])]
        ways += self._round(situation, places[~seen])
        paths = np.array(ways)
        guessed = self._chance(situation, self._beside(field, paths.reshape(-1, 2)))
        guessed = np.nan_to_num(guessed).reshape(paths.shape[:2])
        kept = self._best(situation, paths, guessed, COMPARED)
        paths, guessed = paths[kept], guessed[kept]
        stops = paths[:, -1]
        at_stop = (paths == stops[:, None]).all(axis=2)
        ends = self._chance(situation, situation.power(stops))
        guessed = np.where(at_stop, ends[:, None], guessed)
        tried = TRIED if self._alone else COMPARED
        return [paths[i] for i in self._best(situation, paths, guessed, tried)]

    def _best(
        self,
        situation: StepContext,
        paths: NDArray[np.float64],
        chance: NDArray[np.float64],
        count: int,
    ) -> NDArray[np.intp]:
        """Return which of the paths (c, N, 2) are best if packets arrive by `chance` (c, N)."""
        value = np.zeros(len(paths))
        for number, term in enumerate(situation.problem.terms):
            if term.tries_places:
                value += tried_worth(situation, number, paths, chance)
        missing = np.zeros(len(paths))
        if self._problem.constraints.asks_connection:
            constraints = self._problem.constraints
            each = chance if constraints.rule.by_step else chance.mean(axis=1, keepdims=True)
            missing = np.maximum(constraints.p_min - each, 0.0).sum(axis=1)
        return np.lexsort((-value, np.round(missing, 3)))[:count]

    def _beside(self, field: NodeField, places_m: NDArray[np.float64]) -> Prediction:
        """Return the power at the free node nearest to each place (n, 2)."""
        power = field.nearest(places_m)
        blocked = np.flatnonzero(np.isnan(power.mean_db))
        if len(blocked):
            nodes = self._nodes.nearest(places_m[blocked], 1)[0][:, 0]
            free = field.nearest(self._ground.road_map.nodes_m[nodes])
            power.mean_db[blocked], power.deviation_db[blocked] = free.mean_db, free.deviation_db
        return power

    @cached_property
    def _nodes(self) -> PlaceTree:
        """The free nodes of the lattice."""
        return PlaceTree(self._ground.road_map.nodes_m)

    def _chance(self, situation: StepContext, power: Prediction) -> NDArray[np.float64]:
        return connection_probability(
            power.mean_db, power.deviation_db, situation.thresholds_dbm[0]
        )

    def _places(self, situation: StepContext) -> NDArray[np.float64]:
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
        self, situation: StepContext, hidden_m: NDArray[np.float64]
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
        beside = self._nodes.nearest(hidden_m, 1)[0][:, 0]
        found: list[NDArray[np.float64]] = []
        for node in np.unique(beside[np.isfinite(ways.length_m[beside])]):
            turns = ways.turns_m(int(node), nodes[node])
            stops = stops_along(turns, self._longest_m)[1:]
            if 0 < len(stops) <= horizon:
                found.append(held(situation, list(stops)))
        return found
