"""What stays the same over a whole run: obstacles, lattice, graph. Built once, never changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.errors import NoPlanError
from planopt.planning.road_map import RoadMap, Ways, build_road_map, shortest_ways
from planopt.planning.tolerances import CLEARANCE_PAD_M, STANDSTILL_M, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, index_obstacles
from planopt.world.lattice import build_lattice, moves_from, nearest_node, node_positions
from planopt.world.separation import PackedPieces, pack_pieces


@dataclass(frozen=True)
class Scene:
    """Geometry of a problem, ready for planning.

    Attributes
    ----------
    index
        For the verifier: the obstacles as they are.
    pieces
        For the solver: convex pieces.
    road_map
        The lattice graph; its nodes are anchored at the goal, which is one of them.
    goal_node
        The goal's number in it.
    ways
        Shortest ways round the obstacles to the goal.
    """

    index: ObstacleIndex
    pieces: PackedPieces
    road_map: RoadMap
    goal_node: int
    ways: Ways


def build_scene(problem: Problem) -> Scene:
    """Build the geometry of a problem's first robot.

    Raises
    ------
    NoPlanError
        The obstacles cut the goal off from the start, or no path can end at it.
    """
    robot, clearance = problem.robots[0], problem.constraints.clearance_m
    index = index_obstacles(problem.workspace)
    lattice = build_lattice(
        problem.workspace,
        np.asarray(robot.goal_m),
        problem.step_length_m - STEP_PAD_M,
        clearance + CLEARANCE_PAD_M,
    )
    road_map = build_road_map(lattice)
    goal = np.asarray(robot.goal_m)
    row, column = nearest_node(lattice, goal)
    goal_node = int(road_map.number[row, column])
    if np.linalg.norm(node_positions(lattice)[row, column] - goal) > STANDSTILL_M:
        raise NoPlanError(
            f"robots[0].goal_m {list(robot.goal_m)} lies on the border of world.bounds_m: move it "
            "inside, or widen the bounds"
        )
    if goal_node < 0:
        raise NoPlanError(
            f"robots[0].goal_m {list(robot.goal_m)} is nearer than constraints.clearance_m "
            f"{clearance:g} + {CLEARANCE_PAD_M:g} m to an obstacle"
        )
    ways = shortest_ways(road_map, goal_node)
    scene = Scene(index, pack_pieces(problem.workspace), road_map, goal_node, ways)
    nodes, _ = first_moves(scene, problem, np.asarray(robot.start_m))
    if nodes.size == 0 or not np.isfinite(scene.ways.cost_m[nodes]).any():
        raise NoPlanError(_why_no_way(problem, lattice.spacing_m))
    return scene


def _why_no_way(problem: Problem, spacing_m: float) -> str:
    """Whether obstacles cut the goal off, exactly, or the lattice is too coarse for the way."""
    robot, clearance = problem.robots[0], problem.constraints.clearance_m
    free = shapely.box(*problem.workspace.bounds_m)
    for obstacle in problem.workspace.obstacles:
        free = free.difference(obstacle.polygon.buffer(clearance))
    start, goal = shapely.Point(robot.start_m), shapely.Point(robot.goal_m)
    # Both may lie on the very edge of what the clearance leaves.
    parts = [free] if isinstance(free, shapely.Polygon) else list(shapely.get_parts(free))
    joined = any(
        part.distance(start) <= CLEARANCE_PAD_M and part.distance(goal) <= CLEARANCE_PAD_M
        for part in parts
    )
    between = f"robots[0].goal_m {list(robot.goal_m)} from start_m {list(robot.start_m)}"
    if joined:
        return (
            f"no way found to {between} on a lattice of {spacing_m:.2f} m, although there is one "
            f"with constraints.clearance_m {clearance:g} m: a smaller planner.step_s or "
            "robots[0].speed_max_m_s makes the lattice finer"
        )
    return f"obstacles cut off {between}: no way keeps constraints.clearance_m {clearance:g} m"


def first_moves(
    scene: Scene, problem: Problem, position_m: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Nodes that one step from an off-lattice place can end at, and how long it is to each."""
    lattice = scene.road_map.lattice
    rows, columns, clear = moves_from(
        scene.index,
        lattice,
        position_m,
        problem.step_length_m - STEP_PAD_M,
        problem.constraints.clearance_m,
    )
    nodes = scene.road_map.number[rows[clear], columns[clear]]
    nodes = nodes[nodes >= 0]
    return nodes, np.linalg.norm(scene.road_map.nodes_m[nodes] - position_m, axis=1)
