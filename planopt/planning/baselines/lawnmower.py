"""A baseline that plans nothing: to and fro over all free space, in lanes.

Lanes are rows of the lattice, about a decorrelation distance of the fitted channel apart: what is
measured on them tells of all that lies between. Where an obstacle interrupts one, and from one to
the next, the robot takes the shortest way round. Every move is one of the lattice's, so that all of
it is clear.
"""

from __future__ import annotations

import math
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.planning.baselines.baseline import held, released
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan
from planopt.planning.scene import Ground, first_moves
from planopt.planning.search.taut_way import stops_along
from planopt.planning.tolerances import STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.problems.problem import Problem
from planopt.world.road_map import RoadMap, lattice_paths, way_from

FEWEST_LANES = 3
"""A fit may find a decorrelation distance beyond all that was measured."""


class LawnmowerPlanner:
    """Sweeps one robot of a problem over its workspace; remembers how far it is."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem, self._ground = problem, ground
        self._tour: NDArray[np.intp] | None = None
        self._stops_m: NDArray[np.float64] = np.empty((0, 2))
        self._next = 0

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is; arguments as of the horizon planner, `warm` is not used.

        The first plan begins the tour, and so does one from a place off it; once it is over, the
        robot stands.
        """
        begun = perf_counter()
        here = situation.position_m
        ahead = self._stops_m[self._next :]
        away = np.linalg.norm(ahead - here, axis=1)
        if self._tour is None or not (away <= STANDSTILL_M).any():
            self._begin(here, situation)
        else:
            self._next += int(np.argmax(away <= STANDSTILL_M))
        horizon = self._problem.planner.horizon
        path = self._stops_m[self._next + 1 : self._next + 1 + horizon]
        return released(judge, held(situation, list(path)), begun)

    def _begin(self, here_m: NDArray[np.float64], situation: StepContext) -> None:
        """Lay the stops of the whole tour, or of what is left of it, from `here_m` (2,)."""
        road_map = self._ground.road_map
        nodes, lengths = first_moves(self._ground, self._problem, here_m)
        if not len(nodes):
            self._stops_m, self._next = here_m[None], 0
            return
        first = int(nodes[np.argmin(lengths)])
        apart = min(station.parameters.decorrelation_m for station in situation.stations)
        self._tour = lawn_tour(road_map, first, apart)
        longest = self._problem.step_length_m - STEP_PAD_M
        corners = np.vstack([here_m, road_map.nodes_m[self._tour]])
        self._stops_m, self._next = stops_along(corners, longest), 0


def lawn_tour(road_map: RoadMap, first: int, apart_m: float) -> NDArray[np.intp]:
    """Nodes from `first` on to and fro over all that can be come to; each next one a move away.

    Lanes are about `apart_m` apart, as near as rows of nodes allow.
    """
    tour = [first]
    low, high = int(road_map.rows.min()), int(road_map.rows.max())
    lanes = lane_rows(low, high, apart_m / road_map.lattice.spacing_m)
    # From the nearer side on.
    if road_map.rows[first] - low > high - road_map.rows[first]:
        lanes.reverse()
    middle = 0.5 * (road_map.columns.min() + road_map.columns.max())
    rightward = bool(road_map.columns[first] <= middle)
    for row in lanes:
        lane = np.flatnonzero(road_map.rows == row)
        lane = lane[np.argsort(road_map.columns[lane])]
        for node in map(int, lane if rightward else lane[::-1]):
            if node != tour[-1]:
                tour += _way(road_map, tour[-1], node)
        rightward = not rightward
    return np.asarray(tour, dtype=np.intp)


def lane_rows(low: int, high: int, apart: float) -> list[int]:
    """Rows of lanes about `apart` rows apart, half of that from the first and the last row."""
    rows = high - low + 1
    count = min(max(math.ceil(rows / apart), FEWEST_LANES), rows)
    middles = low + (np.arange(count) + 0.5) * rows / count - 0.5
    return [int(row) for row in np.rint(middles)]


def _way(road_map: RoadMap, here: int, there: int) -> list[int]:
    """Nodes after `here` up to `there`; none if it cannot be come to."""
    moves = road_map.edge_to[road_map.edge_start[here] : road_map.edge_start[here + 1]]
    if there in moves:
        return [there]
    way = way_from(road_map, lattice_paths(road_map, there), here, math.inf)
    return [int(node) for node in way[1:]] if way[-1] == there else []
