"""Obstacles and lattice of a problem. Built once, never changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.search.road_map import RoadMap, build_road_map
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, index_obstacles
from planopt.world.lattice import build_lattice, moves_from
from planopt.world.separation import PackedPieces, pack_pieces


@dataclass(frozen=True)
class Ground:
    """Where robots may be, ready for planning.

    Attributes
    ----------
    index
        For the verifier: the obstacles as they are.
    pieces
        For the solver: convex pieces.
    road_map
        The lattice graph.
    """

    index: ObstacleIndex
    pieces: PackedPieces
    road_map: RoadMap


def build_ground(problem: Problem, anchor_m: NDArray[np.float64]) -> Ground:
    """Build the geometry of a problem, with a node of the lattice at `anchor_m` (2,).

    Raises
    ------
    InputError
        The step is too short, or too long, for the bounds.
    """
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
    return Ground(
        index_obstacles(problem.workspace),
        pack_pieces(problem.workspace),
        build_road_map(lattice),
    )


def first_moves(
    ground: Ground, problem: Problem, position_m: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Nodes that one step from an off-lattice place can end at, and how long it is to each."""
    lattice = ground.road_map.lattice
    rows, columns, clear = moves_from(
        ground.index,
        lattice,
        position_m,
        problem.step_length_m - STEP_PAD_M,
        problem.constraints.clearance_m,
    )
    nodes = ground.road_map.number[rows[clear], columns[clear]]
    nodes = nodes[nodes >= 0]
    return nodes, np.linalg.norm(ground.road_map.nodes_m[nodes] - position_m, axis=1)
