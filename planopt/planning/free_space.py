"""Free space: lattice graph, connectivity of start and goal, and paths out of obstacles."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.tolerances import CLEARANCE_PAD_M, CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.world.clearance import (
    ObstacleIndex,
    clearance_m,
    containing_obstacle,
    distances_m,
    is_clear,
    segment_clearance_m,
    segment_lines,
    swept_clearance_m,
)
from planopt.world.lattice import RoadMap, build_lattice, build_road_map, moves_from, nearest_node
from planopt.world.moving_discs import MovingDiscs, paths_gap_m
from planopt.world.workspace import Obstacle


def build_roads(problem: Problem, anchor_m: NDArray[np.float64]) -> RoadMap:
    """Return the lattice graph of a problem, with a node at `anchor_m` (2,)."""
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
    """Return the index of the node nearest to `place_m` (2,); negative if that node is blocked."""
    row, column = nearest_node(road_map.lattice, place_m)
    return int(road_map.number[row, column])


def nodes_in_reach(
    road_map: RoadMap, index: ObstacleIndex, problem: Problem, position_m: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the nodes within one step of an off-lattice position, and their distances."""
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


def is_joined(problem: Problem, clearance_m: float, without: Obstacle | None = None) -> bool:
    """Return whether a path from start to goal with this clearance exists."""
    polygons = [each.polygon for each in problem.workspace.obstacles if each is not without]
    covered = shapely.union_all(shapely.buffer(polygons, clearance_m))
    free = shapely.box(*problem.workspace.bounds_m).difference(covered)
    start, goal = shapely.Point(problem.robots[0].start_m), shapely.Point(problem.goal_m)
    # Both may lie on the boundary of free space.
    return any(
        part.distance(start) <= CLEARANCE_PAD_M and part.distance(goal) <= CLEARANCE_PAD_M
        for part in shapely.get_parts(free)
        if isinstance(part, shapely.Polygon) and not part.is_empty
    )


def obstacles_met(
    problem: Problem, index: ObstacleIndex, path_m: NDArray[np.float64], first: int = 0
) -> list[str]:
    """Return a reason for every position and segment of a path (n, 2) that violates clearance.

    The path begins after step `first`.
    """
    reasons: list[str] = []
    inside: set[int] = set()
    for step, place in enumerate(path_m):
        obstacle = containing_obstacle(index, place)
        if obstacle is not None:
            inside.add(step)
            x, y = place
            reasons.append(
                f"step {first + step}: ({x:.3f}, {y:.3f}) lies in obstacle {obstacle.name}"
            )
    clearance = swept_clearance_m(index, path_m)
    near = ~is_clear(clearance, problem.constraints.clearance_m, CLEARANCE_TOLERANCE_M)
    lines = segment_lines(path_m[:-1], path_m[1:])
    for segment in np.nonzero(near)[0].tolist():
        if segment in inside or segment + 1 in inside:
            continue
        nearest = index.obstacles[int(np.asarray(index.tree.nearest(lines[segment])))]
        reasons.append(
            f"step {first + segment + 1}: the segment comes within {clearance[segment]:.3f} m of "
            f"obstacle {nearest.name}"
        )
    return reasons


DIRECTIONS, LENGTHS = 48, 8
"""Numbers of directions and of lengths, up to the longest step, of the candidate moves."""

NEARER_M = 1e-9
"""Tolerance of the distances that a move must not reduce."""


def leaving_path(
    problem: Problem, index: ObstacleIndex, moving: MovingDiscs, position_m: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return the path (N, 2) of one step out of violated clearances, bounds or separations.

    Drift or a new obstacle may bring a robot to a position without a sound plan. Among moves that
    approach nothing, the one with the least violation at its end, then the shortest, is chosen; it
    may lead through obstacles that contain the robot. None if nothing is violated or improved.
    """
    # Shapes: position_m (2,).
    horizon = problem.planner.horizon
    lengths = (problem.step_length_m - STEP_PAD_M) * np.arange(1, LENGTHS + 1) / LENGTHS
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    moves = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = np.vstack([position_m, (position_m + lengths[:, None, None] * moves).reshape(-1, 2)])
    wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
    away = clearance_m(index, ends)
    low, high = np.reshape(problem.workspace.bounds_m, (2, 2))
    outside: NDArray[np.float64] = np.linalg.norm(
        np.maximum(np.maximum(low - ends, ends - high), 0.0), axis=1
    )
    paths = np.repeat(ends[:, None], horizon + 1, axis=1)
    paths[:, 0] = position_m
    gap = paths_gap_m(moving, paths)
    deep, others = _inside_m(index, ends)
    static = np.maximum(wanted - away, 0.0) + outside + deep
    now = np.linalg.norm(position_m - moving.centres_m[:, 0], axis=-1)
    if static[0] + np.max(moving.apart_m[:, 0] - now, initial=0.0) == 0.0:
        return None
    lacks = static + _too_near_m(moving, paths)
    swept = segment_clearance_m(others, np.broadcast_to(position_m, ends.shape), ends)
    allowed = swept >= min(float(clearance_m(others, ends[:1])[0]), wanted) - NEARER_M
    allowed &= (swept > 0.0) & (outside <= outside[0] + NEARER_M)
    allowed &= gap >= min(float(gap[0]), 0.0) - NEARER_M
    allowed[0] = True
    rows = np.flatnonzero(allowed)
    # Rows are sorted by length.
    best = int(rows[np.argmin(np.round(lacks[rows], 6))])
    return None if best == 0 else paths[best, 1:]


def _inside_m(
    index: ObstacleIndex, places_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ObstacleIndex]:
    """Return the depth of positions (n, 2) in the first one's obstacles, and the other obstacles.

    Obstacles that intersect the first position's obstacles are included.
    """
    points = np.asarray(shapely.points(places_m), np.object_)
    about = index.tree.query(points[0], predicate="within")
    if not len(about):
        return np.zeros(len(places_m)), index
    about = np.unique(index.tree.query(index.polygons[about], predicate="intersects")[1])
    area = shapely.union_all(index.polygons[about])
    rest = np.delete(np.arange(len(index.obstacles)), about)
    others = tuple(index.obstacles[number] for number in rest)
    polygons = index.polygons[rest]
    border = np.full(len(points), area.boundary, dtype=np.object_)
    deep = np.where(shapely.within(points, area), distances_m(points, border), 0.0)
    return deep, ObstacleIndex(others, polygons, shapely.STRtree(polygons))


def _too_near_m(moving: MovingDiscs, paths_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the separation shortfall of paths (c, N + 1, 2) after the first step; (c,)."""
    if not len(moving):
        return np.zeros(len(paths_m))
    places = int(paths_m.shape[1])
    centres, apart = moving.centres_m[:, 1:places], moving.apart_m[:, : places - 1]
    away = np.linalg.norm(paths_m[:, None, 1:] - centres, axis=-1)
    return np.maximum(apart - away, 0.0).max(axis=(1, 2))
