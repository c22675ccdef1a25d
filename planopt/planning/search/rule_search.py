"""Starts on the way to a goal under a rule of connectivity other than p_min at each step.

Guides (:mod:`planopt.planning.search.guide`) bound steps or credit connections; the lattice path of
each is judged by the rule, and the cheapest that keeps it is taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import bound_margin_db, connection_probability
from planopt.objectives.reach import cost_rate_s_m
from planopt.planning.ground import first_moves
from planopt.planning.scene import Scene
from planopt.planning.search.frontier import OUT_OF_BOUND_FACTOR
from planopt.planning.search.global_search import (
    MISSING_DB_S,
    OUT_OF_BOUND_STEP_S,
    GlobalStart,
)
from planopt.planning.search.guide import Guide, find_guided
from planopt.planning.search.lattice_search import search_lattice
from planopt.planning.search.moving_moves import first_steps_apart
from planopt.planning.search.node_field import NodeField
from planopt.planning.search.road_map import Ways, shortest_ways, way_from
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.planning.worth.rule_rows import step_rows
from planopt.planning.worth.rule_worth import rule_missing
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem

CORRECTIONS = 6
"""How often the lattice is searched again after the nodes of its path got better values."""


class RuleSearch:
    """Finds starts; keeps its map of the channel.

    Parameters
    ----------
    problem, scene
        What is planned, and where.
    """

    def __init__(self, problem: Problem, scene: Scene) -> None:
        self._problem = problem
        self._scene = scene
        self._field = NodeField(scene.road_map.lattice)
        self._rate = cost_rate_s_m(
            problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s
        )

    def find_start(
        self, situation: Situation, node_margin_db: NDArray[np.float64]
    ) -> GlobalStart | None:
        """The cheapest path that keeps the rule, else the one that misses it least; None if none.

        Parameters
        ----------
        situation
            What is known.
        node_margin_db
            Margins of p_min at all nodes, for the cost to go.
        """
        problem, scene = self._problem, self._scene
        self._field.refresh(situation, problem.step_length_m * (problem.planner.horizon + 1))
        ways = scene.ways
        if problem.reach.cost_to_go == "connected":
            factor = np.where(node_margin_db < MARGIN_PAD_DB, OUT_OF_BOUND_FACTOR, 1.0)
            ways = shortest_ways(scene.road_map, scene.goal_node, factor)
        found: dict[bytes, tuple[NDArray[np.intp], float]] = {}

        def search(guide: Guide) -> list[NDArray[np.float64]]:
            nodes = self._path(situation, guide, ways)
            if nodes is None:
                return []
            path = scene.road_map.nodes_m[nodes]
            found[path.tobytes()] = nodes, self._cost(situation, nodes, ways)
            return [path]

        paths = find_guided(situation, search, lambda path: rule_missing(situation, path) == 0.0)
        if not paths:
            return None
        best = min(
            paths,
            key=lambda path: (round(rule_missing(situation, path), 2), found[path.tobytes()][1]),
        )
        nodes = found[best.tobytes()][0]
        way = way_from(scene.road_map, ways, int(nodes[-1]), len(nodes) * problem.step_length_m)
        return GlobalStart(
            nodes=nodes,
            path_m=best,
            margin_db=step_rows(situation, best).margins_db(situation.power(best)),
            beyond_m=scene.road_map.nodes_m[way[1:]],
            ways=ways,
            crossing=False,
        )

    def _path(self, situation: Situation, guide: Guide, ways: Ways) -> NDArray[np.intp] | None:
        """Nodes of the cheapest path under a guide, with good values where it rests on them."""
        problem, road_map = self._problem, self._scene.road_map
        first_nodes, first_lengths = first_moves(self._scene.ground, problem, situation.position_m)
        kept = first_steps_apart(
            situation.circumstances.moving, situation.position_m, road_map.nodes_m[first_nodes]
        )
        first_nodes, first_lengths = first_nodes[kept], first_lengths[kept]
        nodes: NDArray[np.intp] | None = None
        for _ in range(CORRECTIONS + 1):
            found = search_lattice(
                road_map,
                first_nodes,
                first_lengths,
                problem.planner.horizon,
                problem.planner.step_s,
                problem.reach.effort_weight_s2_m2,
                self._scene.goal_node,
                self._penalty_s(guide),
                self._rate * ways.cost_m,
                situation.circumstances.moving,
            )
            if found is None:
                return None
            nodes = found.nodes
            rests = guide.asked.any() or guide.credit.any()
            at = np.stack([road_map.rows[nodes], road_map.columns[nodes]], axis=1)
            if not rests or not self._field.correct(at):
                break
        return nodes

    def _penalty_s(self, guide: Guide) -> NDArray[np.float64]:
        """Penalty of ending each step at each node, ``(N, n)``; negative where it is credited."""
        road_map, threshold = self._scene.road_map, self._problem.stations[0].threshold_dbm
        mean = self._field.mean_db[road_map.rows, road_map.columns]
        deviation = self._field.deviation_db[road_map.rows, road_map.columns]
        known = np.isfinite(mean)
        penalty = np.zeros((len(guide.asked), len(mean)))
        if guide.asked.any():
            margin = bound_margin_db(mean, deviation, threshold, guide.level)
            missing = np.where(known, np.maximum(MARGIN_PAD_DB - margin, 0.0), 0.0)
            below = np.where(missing > 0.0, OUT_OF_BOUND_STEP_S, 0.0) + MISSING_DB_S * missing
            penalty[guide.asked] = below
        if guide.credit.any():
            chance = np.where(known, connection_probability(mean, deviation, threshold), 0.0)
            step_s = self._rate * self._problem.step_length_m
            penalty -= step_s * guide.credit[:, None] * chance
        return penalty

    def _cost(self, situation: Situation, nodes: NDArray[np.intp], ways: Ways) -> float:
        """Length of a path and of the way on from its end, in metres."""
        places = np.vstack([situation.position_m, self._scene.road_map.nodes_m[nodes]])
        driven = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
        return float(driven + ways.cost_m[nodes[-1]])
