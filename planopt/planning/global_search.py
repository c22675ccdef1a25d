"""The global start of a plan: a lattice path whose connectivity is exact where it matters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.reach import cost_rate_s_m
from planopt.planning.lattice_search import search_lattice
from planopt.planning.node_margins import NodeMargins
from planopt.planning.road_map import Ways, shortest_ways, way_from
from planopt.planning.scene import Scene, first_moves
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.problems.problem import Problem

OUT_OF_BOUND_FACTOR = 100.0
"""A metre below the bound counts as this many metres in the `connected` cost to go, so that the
way out of contact is the shortest there is."""
CLOSED_FACTOR = 1e4
"""The same for a gap that the robot has stood before in vain: only if no other way is left."""
CLOSED_RADIUS_STEPS = 2.0
"""How far about such a gap the nodes below the bound are closed, in longest steps: a street."""
STAGNANT_STEPS = 0.75
"""A path that stays within this many longest steps of the robot gets nowhere; a lattice path can
only end on a node, so that even one that wants to stay moves a little."""
MAX_CLOSINGS = 20
"""How many gaps may be closed in one step."""
OUT_OF_BOUND_STEP_S = 1e5
"""Penalty of a step below the bound: no saving of time is worth one."""
MISSING_DB_S = 1e3
"""Penalty of a missing dB: among as many steps below the bound, the least missing dB wins."""
CORRECTION_ROUNDS = 8
"""How often the search is repeated with exact margins along its path."""


@dataclass(frozen=True)
class GlobalStart:
    """Where the polish starts.

    Attributes
    ----------
    nodes
        ``(N,)`` lattice nodes.
    path_m
        ``(N, 2)`` their places.
    margin_db
        ``(N,)`` exact connectivity margins there.
    ways
        Cost to go of every node.
    """

    nodes: NDArray[np.intp]
    path_m: NDArray[np.float64]
    margin_db: NDArray[np.float64]
    ways: Ways


class GlobalSearch:
    """Finds start paths; remembers the gaps in connectivity that it has given up on.

    With the `connected` cost to go the robot is drawn to the cheapest gap between it and the goal.
    As long as the bound holds it may not enter, and once it stands before the gap there is nothing
    new to learn: so the gap is closed, and the next cheapest one draws it. A gap that measurements
    bring within the bound is none any more, closed or not.

    Parameters
    ----------
    problem, scene
        What is planned, and where.
    margins
        Connectivity margins of the nodes, kept up to date by the caller.
    """

    def __init__(self, problem: Problem, scene: Scene, margins: NodeMargins) -> None:
        self._problem = problem
        self._scene = scene
        self._margins = margins
        self._closed = np.zeros(len(scene.road_map.nodes_m), dtype=bool)

    def find_start(self, position_m: NDArray[np.float64]) -> GlobalStart | None:
        """Search from `position_m`; None if no node is in reach.

        A step below the bound is taken only where every lattice path has one.
        """
        start = self._search(position_m)
        if self._problem.objective.cost_to_go == "connected":
            for _ in range(MAX_CLOSINGS):
                if start is None or not self._close_gap(position_m, start):
                    break
                start = self._search(position_m)
        return start

    def _search(self, position_m: NDArray[np.float64]) -> GlobalStart | None:
        """One search with today's margins, closed gaps and exact values along the path."""
        settings, objective = self._problem.planner, self._problem.objective
        scene, margins = self._scene, self._margins
        weight = objective.effort_weight_s2_m2
        rate = cost_rate_s_m(weight, self._problem.robots[0].speed_max_m_s)
        first_nodes, first_lengths = first_moves(scene, self._problem, position_m)
        if first_nodes.size == 0:
            return None
        ways = self._ways()
        nodes: NDArray[np.intp] | None = None
        for _ in range(CORRECTION_ROUNDS):
            missing = np.maximum(MARGIN_PAD_DB - margins.margin_db, 0.0)
            found = search_lattice(
                scene.road_map,
                first_nodes,
                first_lengths,
                settings.horizon,
                settings.step_s,
                weight,
                scene.goal_node,
                np.where(missing > 0.0, OUT_OF_BOUND_STEP_S, 0.0) + MISSING_DB_S * missing,
                rate * ways.cost_m,
            )
            if found is None:
                return None
            nodes = found.nodes
            # Below the bound already at the first step: make sure of every place in reach.
            doubtful = margins.margin_db[nodes[0]] < MARGIN_PAD_DB
            if not margins.correct(np.concatenate([nodes, first_nodes]) if doubtful else nodes):
                break
        if nodes is None:
            raise AssertionError("at least one round is searched")
        return GlobalStart(nodes, scene.road_map.nodes_m[nodes], margins.margin_db[nodes], ways)

    def _ways(self) -> Ways:
        """Cost to go of every node."""
        if self._problem.objective.cost_to_go == "geodesic":
            return self._scene.ways
        outside = self._margins.margin_db < MARGIN_PAD_DB
        factor = np.where(outside, OUT_OF_BOUND_FACTOR, 1.0)
        factor[outside & self._closed] = CLOSED_FACTOR
        return shortest_ways(self._scene.road_map, self._scene.goal_node, factor)

    def _close_gap(self, position_m: NDArray[np.float64], start: GlobalStart) -> bool:
        """Close the first gap on the way of a path that gets nowhere; false if nothing changed."""
        length = self._problem.step_length_m
        nodes_m = self._scene.road_map.nodes_m
        farthest = np.linalg.norm(start.path_m - position_m, axis=1).max()
        end = int(start.nodes[-1])
        if farthest > STAGNANT_STEPS * length or end == self._scene.goal_node:
            return False
        way = way_from(self._scene.road_map, start.ways, end, np.inf)
        outside = self._margins.margin_db < MARGIN_PAD_DB
        gaps = way[outside[way]]
        if gaps.size == 0:
            return False
        near = np.linalg.norm(nodes_m - nodes_m[gaps[0]], axis=1) <= CLOSED_RADIUS_STEPS * length
        closing = near & outside & ~self._closed
        self._closed |= closing
        return bool(closing.any())
