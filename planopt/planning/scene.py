"""Geometry of a run: obstacles and lattice, built once, and shortest paths."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.errors import InputError, NoPlanError
from planopt.planning.free_space import build_roads, is_joined
from planopt.planning.tolerances import CLEARANCE_PAD_M, STANDSTILL_M, STEP_PAD_M
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.clearance import ObstacleIndex, index_obstacles, inside_bounds, segments_clear
from planopt.world.lattice import (
    REACH_TOLERANCE_M,
    CostToGo,
    RoadMap,
    lattice_paths,
    nearest_node,
    nodes_in_reach,
    route_from,
)
from planopt.world.separation import PackedPieces, pack_pieces


@dataclass(frozen=True)
class Ground:
    """Obstacles, their convex pieces, and the lattice of the free space."""

    index: ObstacleIndex  # Exact obstacles, for the verifier
    pieces: PackedPieces  # Convex pieces, for the solver
    road_map: RoadMap  # Lattice graph


def build_ground(problem: Problem, anchor_m: Floats, shared: Ground | None = None) -> Ground:
    """Return the geometry of a problem, with a lattice node at `anchor_m` (2,)."""
    # `shared` is the ground of another robot, whose obstacles are reused.
    workspace = problem.workspace
    return Ground(
        index_obstacles(workspace) if shared is None else shared.index,
        pack_pieces(workspace) if shared is None else shared.pieces,
        build_roads(problem, anchor_m),
    )


def first_moves(ground: Ground, problem: Problem, position_m: Floats) -> tuple[Indices, Floats]:
    """Return the nodes within one step of an off-lattice position, and their distances."""
    reach_m, clearance_m = problem.step_length_m - STEP_PAD_M, problem.constraints.clearance_m
    return nodes_in_reach(ground.road_map, ground.index, position_m, reach_m, clearance_m)


@dataclass(frozen=True)
class Scene(Ground):
    """Geometry of a problem with a goal: ground, lattice node of the goal, and shortest paths."""

    goal_node: int  # Index of this node
    cost_to_go: CostToGo  # Shortest paths around obstacles to the goal


def build_scene(
    problem: Problem,
    place_m: Floats | None = None,  # (2,) the robot's position; None: the start
    shared: Ground | None = None,
) -> Scene:
    """Return the geometry of a problem's first robot; raise a NoPlanError if no path exists."""
    clearance, goal_m = problem.constraints.clearance_m, problem.goal_m
    goal = np.asarray(goal_m)
    ground = build_ground(problem, goal, shared)
    road_map = ground.road_map
    lattice = road_map.lattice
    row, column = nearest_node(lattice, goal)
    goal_node = int(road_map.number[row, column])
    if np.linalg.norm(lattice.positions_m[row, column] - goal) > STANDSTILL_M:
        raise NoPlanError(
            f"the goal robots[0].goal_m = {list(goal_m)} is on the edge of world.bounds_m: "
            "move it inside, or enlarge the bounds"
        )
    if goal_node < 0:
        raise NoPlanError(
            f"the goal robots[0].goal_m = {list(goal_m)} is closer to an obstacle than "
            f"constraints.clearance_m = {clearance:g} m (plus {CLEARANCE_PAD_M:g} m): move it, "
            "or reduce the clearance"
        )
    cost_to_go = lattice_paths(road_map, goal_node)
    scene = Scene(ground.index, ground.pieces, road_map, goal_node, cost_to_go)
    here = np.asarray(problem.robots[0].start_m) if place_m is None else place_m
    nodes, _ = first_moves(ground, problem, here)
    if nodes.size == 0 and place_m is not None:
        # The robot must first leave a newly discovered obstacle.
        return scene
    if nodes.size == 0 or not np.isfinite(scene.cost_to_go.cost_m[nodes]).any():
        raise NoPlanError(_why_no_path(problem, lattice.spacing_m, here))
    return scene


def build_scenes(
    problem: Problem, places_m: Sequence[Floats] | None = None
) -> tuple[Scene, ...] | None:
    """Return the geometry of each robot at positions (2,); None for problems without goals."""
    if not problem.has_goal:
        return None
    scenes: list[Scene] = []
    for number, robot in enumerate(problem.robots):
        try:
            here = None if places_m is None else places_m[number]
            shared = scenes[0] if scenes else None
            scenes.append(build_scene(problem_of_robot(problem, number), here, shared))
        except NoPlanError as error:
            if len(problem.robots) == 1:
                raise
            words = str(error).replace("robots[0]", f"robots[{number}]")
            raise NoPlanError(f"{robot.name}: {words}") from None
    return tuple(scenes)


def _why_no_path(problem: Problem, spacing_m: float, place_m: Floats) -> str:
    """Return the reason why no path exists: enclosing obstacles, or too coarse a lattice."""
    start_m = tuple(place_m.tolist())
    what = "the start" if start_m == problem.robots[0].start_m else "the position"
    robot = replace(problem.robots[0], start_m=start_m)
    problem, goal_m = replace(problem, robots=(robot,)), problem.goal_m
    clearance = problem.constraints.clearance_m
    between = f"the goal robots[0].goal_m = {list(goal_m)} from {what} {list(start_m)}"
    if is_joined(problem, clearance):
        return (
            f"the search lattice of {spacing_m:.2f} m is too coarse: it has no path to "
            f"{between}, although a path with constraints.clearance_m = {clearance:g} m "
            "exists. Reduce planner.step_s or robots[0].speed_max_m_s for a finer lattice"
        )
    return f"obstacles separate {between}: no path keeps constraints.clearance_m = {clearance:g} m"


def free_ends(problem: Problem, ground: Ground, position_m: Floats, ends_m: Floats) -> Mask:
    """Return a mask (n,) of collision-free segments from a position (2,) to `ends_m` (n, 2).

    Raises
    ------
    InputError
        If the shape of `ends_m` is not (n, 2).
    """
    if np.ndim(ends_m) != 2 or np.shape(ends_m)[1] != 2:
        raise InputError(
            f"has shape {np.shape(ends_m)}, should have shape (n, 2)",
            key="ends_m",
            remedy="give x and y of each position in metres",
        )
    starts = np.broadcast_to(position_m, ends_m.shape)
    wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
    clear = segments_clear(ground.index, starts, ends_m, wanted)
    return inside_bounds(problem.workspace, ends_m) & clear


STRAIGHT_SHARE = 1e-9  # Minimum difference of two legs' directions that counts as a turn


class PathsFrom:
    """Shortest paths from one position to all reachable nodes of a lattice."""

    def __init__(
        self, problem: Problem, ground: Ground, position_m: Floats, limit_m: float = math.inf
    ) -> None:
        self._ground, self._position_m = ground, position_m
        self._wanted_m = problem.constraints.clearance_m + CLEARANCE_PAD_M
        nodes, lengths = first_moves(ground, problem, position_m)
        self.length_m = np.full(len(ground.road_map.nodes_m), np.inf)
        self._cost_to_go: CostToGo | None = None
        if len(nodes):
            nearest = int(np.argmin(lengths))
            self._cost_to_go = lattice_paths(ground.road_map, int(nodes[nearest]), limit_m=limit_m)
            self.length_m = self._cost_to_go.cost_m + float(lengths[nearest])

    def straight(self, places_m: Floats) -> Mask:
        """Return a mask of positions (n, 2) to which the straight line is collision-free."""
        starts = np.broadcast_to(self._position_m, places_m.shape)
        return segments_clear(self._ground.index, starts, places_m, self._wanted_m)

    def turns_m(self, node: int, end_m: Floats) -> Floats:
        """Return start, turns and end (m, 2) of the path to a position (2,) next to `node`."""
        if self._cost_to_go is None:
            raise AssertionError("no node is reachable")
        nodes = route_from(self._ground.road_map, self._cost_to_go, node, math.inf)[::-1]
        corners = np.vstack([self._position_m, self._ground.road_map.nodes_m[nodes], end_m])
        return taut_turns(self._ground, self._wanted_m, corners)


def taut_turns(
    ground: Ground,
    clearance_m: float,
    corners_m: Floats,  # (n, 2)
    is_cheap: Callable[[int], Mask] | None = None,
) -> Floats:
    """Return the turns (m, 2) of a path, each the farthest corner visible from its predecessor."""
    # `is_cheap` maps a corner's index to a mask of the later corners with a cheap straight leg.
    turns, last = [corners_m[0]], 0
    while last < len(corners_m) - 1:
        ahead = corners_m[last + 1 :]
        starts = np.broadcast_to(corners_m[last], ahead.shape)
        allowed = segments_clear(ground.index, starts, ahead, clearance_m)
        if is_cheap is not None:
            allowed &= is_cheap(last)
        seen = np.flatnonzero(allowed)
        # The next corner is one move away, so clearance and cost need no test.
        last += 1 + (int(seen[-1]) if len(seen) else 0)
        turns.append(corners_m[last])
    return np.array(turns)


def stops_along(corners_m: Floats, longest_m: float) -> Floats:
    """Return stops (s, 2) along a path, at its turns and at most `longest_m` apart."""
    legs = np.diff(corners_m, axis=0)
    length = np.linalg.norm(legs, axis=1)
    corners = corners_m[np.concatenate([[True], length > 0.0])]
    legs, length = legs[length > 0.0], length[length > 0.0]
    along = legs / length[:, None]
    turns = np.linalg.norm(np.diff(along, axis=0), axis=1) > STRAIGHT_SHARE
    corners = corners[np.concatenate([[True], turns, [True]])] if len(legs) else corners
    stops = [corners[:1]]
    for start, end in pairwise(corners):
        steps = math.ceil(float(np.linalg.norm(end - start)) / longest_m)
        stops.append(start + (end - start) * (np.arange(1, steps + 1) / steps)[:, None])
    return np.concatenate(stops)


def retime(start_m: Floats, path_m: Floats, beyond_m: Floats, step_m: float) -> Floats:
    """Return N positions (N, 2) `step_m` apart along the polyline of a path and its route."""
    # Shapes: start_m (2,), position of the robot; path_m (N, 2), its path; final waiting steps mean
    # arrival; beyond_m (b, 2).
    horizon = len(path_m)
    arrived = horizon > 1 and bool((path_m[-1] == path_m[-2]).all())
    line = np.vstack([start_m, path_m] if arrived else [start_m, path_m, beyond_m])
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    line = line[np.concatenate([[True], lengths > 0.0])]
    travelled = np.concatenate([[0.0], lengths[lengths > 0.0].cumsum()])
    total = float(travelled[-1])
    if total == 0.0:
        return path_m
    # Up to rounding, a lattice path of n longest moves takes n steps.
    steps = max(int(np.ceil((total - REACH_TOLERANCE_M) / step_m)), 1)
    if steps <= horizon:
        step_m = total / steps
    stops = np.minimum(step_m * np.arange(1, horizon + 1), total)
    return np.stack(
        [np.interp(stops, travelled, line[:, 0]), np.interp(stops, travelled, line[:, 1])], axis=1
    )
