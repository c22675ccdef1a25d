"""The lattice of a problem as a graph: where its robots may drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex
from planopt.world.lattice import build_lattice, moves_from, nearest_node
from planopt.world.road_map import RoadMap, build_road_map


def build_roads(problem: Problem, anchor_m: NDArray[np.float64]) -> RoadMap:
    """Build the graph, with a node at `anchor_m` (2,)."""
    try:
        lattice = build_lattice(
            problem.workspace,
            anchor_m,
            problem.step_length_m - STEP_PAD_M,
            problem.constraints.clearance_m + CLEARANCE_PAD_M,
        )
    except InputError as error:
        raise InputError(
            error.message, file=problem.file, key="planner.step_s", remedy=error.remedy
        ) from None
    return build_road_map(lattice)


def node_at(road_map: RoadMap, place_m: NDArray[np.float64]) -> int:
    """Return the number of the node nearest to `place_m` (2,); negative if that is not free."""
    row, column = nearest_node(road_map.lattice, place_m)
    return int(road_map.number[row, column])


def nodes_in_reach(
    road_map: RoadMap, index: ObstacleIndex, problem: Problem, position_m: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Nodes that one step from an off-lattice place can end at, and how long it is to each."""
    rows, columns, clear = moves_from(
        index,
        road_map.lattice,
        position_m,
        problem.step_length_m - STEP_PAD_M,
        problem.constraints.clearance_m,
    )
    nodes = road_map.number[rows[clear], columns[clear]]
    nodes = nodes[nodes >= 0]
    return nodes, np.linalg.norm(road_map.nodes_m[nodes] - position_m, axis=1)
