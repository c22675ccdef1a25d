"""Geometry of a run: obstacles and lattice, built once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, NoPlanError
from planopt.planning.free_space import build_roads, is_joined, nodes_in_reach
from planopt.planning.tolerances import CLEARANCE_PAD_M, STANDSTILL_M
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.clearance import ObstacleIndex, index_obstacles, inside_bounds, segments_clear
from planopt.world.lattice import CostToGo, RoadMap, lattice_paths, nearest_node, node_positions
from planopt.world.separation import PackedPieces, pack_pieces


@dataclass(frozen=True)
class Ground:
    """Free space for planning: obstacles, convex pieces, lattice."""

    index: ObstacleIndex  # Exact obstacles, for the verifier
    pieces: PackedPieces  # Convex pieces, for the solver
    road_map: RoadMap  # Lattice graph


def build_ground(
    problem: Problem, anchor_m: NDArray[np.float64], beside: Ground | None = None
) -> Ground:
    """Return the geometry of a problem, with a lattice node at `anchor_m` (2,).

    If the ground `beside` of another robot is given, its obstacles are reused.
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
    """Return the nodes within one step of an off-lattice position, and their distances."""
    return nodes_in_reach(ground.road_map, ground.index, problem, position_m)


@dataclass(frozen=True)
class Scene:
    """Geometry of a problem with a goal."""

    ground: Ground  # Geometry with a lattice node at the goal
    goal_node: int  # Index of this node
    ways: CostToGo  # Shortest paths around obstacles to the goal

    @property
    def index(self) -> ObstacleIndex:
        """Return the exact obstacles, for the verifier."""
        return self.ground.index

    @property
    def pieces(self) -> PackedPieces:
        """Return the convex pieces, for the solver."""
        return self.ground.pieces

    @property
    def road_map(self) -> RoadMap:
        """Lattice graph."""
        return self.ground.road_map


def build_scene(
    problem: Problem,
    place_m: NDArray[np.float64] | None = None,  # (2,) the robot's position; None: the start
    beside: Ground | None = None,
) -> Scene:
    """Return the geometry of a problem's first robot; raise a NoPlanError if no path exists."""
    clearance, goal_m = problem.constraints.clearance_m, problem.goal_m
    goal = np.asarray(goal_m)
    ground = build_ground(problem, goal, beside)
    road_map = ground.road_map
    lattice = road_map.lattice
    row, column = nearest_node(lattice, goal)
    goal_node = int(road_map.number[row, column])
    if np.linalg.norm(node_positions(lattice)[row, column] - goal) > STANDSTILL_M:
        raise NoPlanError(
            f"robots[0].goal_m {list(goal_m)} lies on the border of world.bounds_m: move it "
            "inside, or widen the bounds"
        )
    if goal_node < 0:
        raise NoPlanError(
            f"robots[0].goal_m {list(goal_m)} is nearer than constraints.clearance_m "
            f"{clearance:g} + {CLEARANCE_PAD_M:g} m to an obstacle"
        )
    ways = lattice_paths(road_map, goal_node)
    scene = Scene(ground, goal_node, ways)
    here = np.asarray(problem.robots[0].start_m) if place_m is None else place_m
    nodes, _ = first_moves(ground, problem, here)
    if nodes.size == 0 and place_m is not None:
        # The robot must first leave a newly discovered obstacle.
        return scene
    if nodes.size == 0 or not np.isfinite(scene.ways.cost_m[nodes]).any():
        raise NoPlanError(_why_no_way(problem, lattice.spacing_m, here))
    return scene


def build_scenes(
    problem: Problem, places_m: Sequence[NDArray[np.float64]] | None = None
) -> tuple[Scene, ...] | None:
    """Return the geometry of each robot at positions (2,); None for problems without goals."""
    if problem.task != "reach":
        return None
    scenes: list[Scene] = []
    for number, robot in enumerate(problem.robots):
        try:
            here = None if places_m is None else places_m[number]
            beside = scenes[0].ground if scenes else None
            scenes.append(build_scene(problem_of_robot(problem, number), here, beside))
        except NoPlanError as error:
            if len(problem.robots) == 1:
                raise
            words = str(error).replace("robots[0]", f"robots[{number}]")
            raise NoPlanError(f"{robot.name}: {words}") from None
    return tuple(scenes)


def _why_no_way(problem: Problem, spacing_m: float, place_m: NDArray[np.float64]) -> str:
    """Return whether obstacles cut the goal off or the lattice is too coarse, in words."""
    start_m = tuple(place_m.tolist())
    what = "start_m" if start_m == problem.robots[0].start_m else "the place"
    robot = replace(problem.robots[0], start_m=start_m)
    problem, goal_m = replace(problem, robots=(robot,)), problem.goal_m
    clearance = problem.constraints.clearance_m
    between = f"robots[0].goal_m {list(goal_m)} from {what} {list(start_m)}"
    if is_joined(problem, clearance):
        return (
            f"no path found to {between} on a lattice of {spacing_m:.2f} m, although there is one "
            f"with constraints.clearance_m {clearance:g} m: a smaller planner.step_s or "
            "robots[0].speed_max_m_s makes the lattice finer"
        )
    return f"obstacles cut off {between}: no path keeps constraints.clearance_m {clearance:g} m"


def free_ends(
    problem: Problem, ground: Ground, position_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return whether the segment from a position (2,) to each of `ends_m` (n, 2) is free; (n,).

    Raises
    ------
    InputError
        If the shape of `ends_m` is not (n, 2).
    """
    if np.ndim(ends_m) != 2 or np.shape(ends_m)[1] != 2:
        raise InputError(
            f"has the shape {np.shape(ends_m)}", key="ends_m", remedy="give places (n, 2)"
        )
    starts = np.broadcast_to(position_m, ends_m.shape)
    wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
    clear = segments_clear(ground.index, starts, ends_m, wanted)
    return inside_bounds(problem.workspace, ends_m) & clear
