"""Obstacles and lattice of a problem. Built once, never changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.roads import build_roads, nodes_in_reach
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, index_obstacles
from planopt.world.road_map import RoadMap
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


def build_ground(
    problem: Problem, anchor_m: NDArray[np.float64], beside: Ground | None = None
) -> Ground:
    """Build the geometry of a problem, with a node of the lattice at `anchor_m` (2,).

    Robots of one workspace share the obstacles of the ground `beside` that another has.

    Raises
    ------
    InputError
        The step is too short, or too long, for the bounds.
    """
    workspace = problem.workspace
    return Ground(
        index_obstacles(workspace) if beside is None else beside.index,
        pack_pieces(workspace) if beside is None else beside.pieces,
        build_roads(problem, anchor_m),
    )


def first_moves(
    ground: Ground, problem: Problem, position_m: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Nodes that one step from an off-lattice place can end at, and how long it is to each."""
    return nodes_in_reach(ground.road_map, ground.index, problem, position_m)
