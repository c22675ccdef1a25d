"""How a robot is steered to its goal: along the shortest way that keeps ``p_min``, round holes.

A sum of terms does not leave contact at a price, so that the way leaves it only where every way
does, and as little as can be. It turns where it must, for an obstacle or for a hole.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.terms.term import Term
from planopt.planning.ground import Ground, first_moves
from planopt.planning.search.global_search import FORBIDDEN
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.steering_way import SteeringWay, steering_way
from planopt.problems.problem import Problem
from planopt.world.clearance import segments_clear
from planopt.world.road_map import shortest_ways, way_from

TAUT_SHARE = 1.02
"""A leg may cost this many times what the way along the nodes costs, which bends more."""


class GoalSteering:
    """Finds the cheapest way to the goal; keeps its map of the channel.

    Parameters
    ----------
    problem
        With one robot, and its goal.
    ground
        Its geometry.
    """

    def __init__(self, problem: Problem, ground: Ground, _term: Term) -> None:
        self._problem, self._ground = problem, ground
        self._goal_m = np.asarray(problem.goal_m)
        self._wanted_m = problem.constraints.clearance_m + CLEARANCE_PAD_M
        threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min
        self._bounded = p_min > 0.0
        self._margins = NodeMargins(ground.road_map, threshold, p_min)
        nodes, lengths = first_moves(ground, problem, self._goal_m)
        self._goal_node = int(nodes[lengths.argmin()]) if len(nodes) else None

    def find_way(self, situation: Situation) -> SteeringWay | None:
        """Return the cheapest way on what is believed now; None if obstacles cut the goal off.

        Parameters
        ----------
        situation
            What is known; how it is steered is not looked at.
        """
        road_map, here = self._ground.road_map, situation.position_m
        nodes, lengths = first_moves(self._ground, self._problem, here)
        if self._goal_node is None or not len(nodes):
            return None
        self._margins.refresh(situation.posterior, situation.circumstances.broad)
        metre_cost = np.where(self._margins.outside & self._bounded, FORBIDDEN, 1.0)
        ways = shortest_ways(road_map, self._goal_node, metre_cost)
        cost = lengths * metre_cost[nodes] + ways.cost_m[nodes]
        first = int(nodes[cost.argmin()])
        if not np.isfinite(ways.cost_m[first]):
            return None
        along = way_from(road_map, ways, first, math.inf)
        corners = np.vstack([here, road_map.nodes_m[along], self._goal_m])
        # Beside the way's own nodes, the robot and the goal cost what the nearest nodes cost.
        at_corner = metre_cost[np.concatenate([[first], along, [self._goal_node]])]
        farthest = float(ways.cost_m[np.isfinite(ways.cost_m)].max())
        lattice = np.full(road_map.lattice.shape, farthest)
        lattice[road_map.rows, road_map.columns] = np.minimum(ways.cost_m, farthest)
        turns = self._turns_m(corners, at_corner, metre_cost)
        return steering_way(self._problem, self._ground.index, turns, lattice)

    def _turns_m(
        self,
        corners_m: NDArray[np.float64],
        at_corner: NDArray[np.float64],
        metre_cost: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """The way through `corners_m` (n, 2) pulled taut where that costs no more; (m, 2)."""
        legs = np.linalg.norm(np.diff(corners_m, axis=0), axis=1)
        spent = np.append(0.0, np.cumsum(legs * 0.5 * (at_corner[1:] + at_corner[:-1])))
        turns, last = [corners_m[0]], 0
        while last < len(corners_m) - 1:
            ahead = corners_m[last + 1 :]
            starts = np.broadcast_to(corners_m[last], ahead.shape)
            clear = segments_clear(self._ground.index, starts, ahead, self._wanted_m)
            allowed = TAUT_SHARE * (spent[last + 1 :] - spent[last])
            cheap = self._leg_costs_m(corners_m[last], ahead, metre_cost) <= allowed
            seen = np.flatnonzero(clear & cheap)
            # The next corner is a move away, whatever it costs.
            last += 1 + (int(seen[-1]) if len(seen) else 0)
            turns.append(corners_m[last])
        return np.array(turns)

    def _leg_costs_m(
        self,
        start_m: NDArray[np.float64],
        ends_m: NDArray[np.float64],
        metre_cost: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """What straight legs to `ends_m` (n, 2) cost, at the nodes nearest to places on them."""
        road_map = self._ground.road_map
        lattice = road_map.lattice
        lengths = np.linalg.norm(ends_m - start_m, axis=1)
        count = math.ceil(float(lengths.max()) / lattice.spacing_m) + 1
        share = (np.arange(count) + 0.5) / count
        places = start_m + share[None, :, None] * (ends_m - start_m)[:, None]
        cell = np.rint((places - np.asarray(lattice.origin_m)) / lattice.spacing_m).astype(int)
        ny, nx = lattice.shape
        column, row = np.clip(cell[..., 0], 0, nx - 1), np.clip(cell[..., 1], 0, ny - 1)
        number = road_map.number[row, column]
        # Nodes beside an obstacle may be no nodes at all: what the way costs there is not known.
        return lengths * np.where(number >= 0, metre_cost[number], 1.0).mean(axis=1)
