"""The global start of a plan: a lattice path whose connectivity is exact where it matters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.reach import cost_rate_s_m
from planopt.planning.lattice_search import search_lattice
from planopt.planning.node_margins import NodeMargins
from planopt.planning.road_map import Ways, shortest_ways
from planopt.planning.scene import Scene, first_moves
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.problems.problem import Problem

OUT_OF_BOUND_FACTOR = 100.0
"""A metre below the bound counts as this many metres in the `connected` cost to go, so that the
way out of contact is the shortest there is."""
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


def find_start(
    problem: Problem, scene: Scene, margins: NodeMargins, position_m: NDArray[np.float64]
) -> GlobalStart | None:
    """Search the lattice; None if no node is in reach.

    A step below the bound is taken only where every lattice path has one.
    """
    settings, objective = problem.planner, problem.objective
    weight = objective.effort_weight_s2_m2
    rate = cost_rate_s_m(weight, problem.robots[0].speed_max_m_s)
    first_nodes, first_lengths = first_moves(scene, problem, position_m)
    if first_nodes.size == 0:
        return None
    ways = scene.ways
    if objective.cost_to_go == "connected":
        inside = margins.margin_db >= MARGIN_PAD_DB
        factor = np.where(inside, 1.0, OUT_OF_BOUND_FACTOR)
        ways = shortest_ways(scene.road_map, scene.goal_node, factor)
    terminal = rate * ways.cost_m
    nodes: NDArray[np.intp] | None = None
    for _ in range(CORRECTION_ROUNDS):
        missing = np.maximum(MARGIN_PAD_DB - margins.margin_db, 0.0)
        penalty = np.where(missing > 0.0, OUT_OF_BOUND_STEP_S, 0.0) + MISSING_DB_S * missing
        found = search_lattice(
            scene.road_map,
            first_nodes,
            first_lengths,
            settings.horizon,
            settings.step_s,
            weight,
            scene.goal_node,
            penalty,
            terminal,
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
