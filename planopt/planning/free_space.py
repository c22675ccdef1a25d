"""Free space of a problem: lattice graph, reachability of the goal, random positions."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import shapely

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.planning.tolerances import CLEARANCE_PAD_M, CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.problems.robot import Robot
from planopt.problems.settings import Target
from planopt.world.clearance import (
    ObstacleIndex,
    clearance_m,
    containing_obstacle,
    distances_m,
    index_obstacles,
    inside_bounds,
    is_clear,
    polygons_of,
    segment_clearance_m,
    segment_lines,
    swept_clearance_m,
)
from planopt.world.lattice import RoadMap, build_lattice, build_road_map
from planopt.world.motion import MovingDiscs, paths_gap_m
from planopt.world.workspace import Obstacle


def build_roads(problem: Problem, anchor_m: Floats) -> RoadMap:
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


def is_joined(problem: Problem, clearance_m: float, without: Obstacle | None = None) -> bool:
    """Return whether a continuous path from start to goal keeps `clearance_m` to obstacles."""
    polygons = [each.polygon for each in problem.workspace.obstacles if each is not without]
    covered = shapely.union_all(shapely.buffer(polygons, clearance_m))
    free = shapely.box(*problem.workspace.bounds_m).difference(covered)
    start, goal = shapely.Point(problem.robots[0].start_m), shapely.Point(problem.goal_m)
    # Start and goal may lie on the boundary of free space.
    return any(
        part.distance(start) <= CLEARANCE_PAD_M and part.distance(goal) <= CLEARANCE_PAD_M
        for part in polygons_of(free)
    )


def obstacles_met(problem: Problem, index: ObstacleIndex, path_m: Floats) -> list[str]:
    """Return a message per violation of clearance, by a position or segment of a path (n, 2)."""
    reasons: list[str] = []
    inside: set[int] = set()
    for step, place in enumerate(path_m):
        obstacle = containing_obstacle(index, place)
        if obstacle is not None:
            inside.add(step)
            x, y = place
            reasons.append(f"step {step}: ({x:.3f}, {y:.3f}) lies in obstacle {obstacle.name}")
    clearance = swept_clearance_m(index, path_m)
    near = ~is_clear(clearance, problem.constraints.clearance_m, CLEARANCE_TOLERANCE_M)
    lines = segment_lines(path_m[:-1], path_m[1:])
    for segment in np.nonzero(near)[0].tolist():
        if segment in inside or segment + 1 in inside:
            continue
        nearest = index.obstacles[int(np.asarray(index.tree.nearest(lines[segment])))]
        reasons.append(
            f"step {segment + 1}: the segment comes within {clearance[segment]:.3f} m of "
            f"obstacle {nearest.name}"
        )
    return reasons


DIRECTIONS, LENGTHS = 48, 8
"""Numbers of directions and lengths of the candidate moves out of a violation."""
NEARER_M = 1e-9  # Tolerance within which a move may reduce a distance, in metres


def leaving_path(
    problem: Problem, index: ObstacleIndex, moving: MovingDiscs, position_m: Floats
) -> Floats | None:
    """Return a path (N, 2) whose first step reduces violations of distances and bounds, or None."""
    # After drift or next to a new obstacle, a robot may have no safe plan. Of the moves that reduce
    # no distance, the one with the least violation at its end, then the shortest, is chosen; it may
    # cross obstacles that contain the robot. None if no constraint is violated or no move helps.
    # Shapes: position_m (2,).
    horizon = problem.planner.horizon
    lengths = (problem.step_length_m - STEP_PAD_M) * np.arange(1, LENGTHS + 1) / LENGTHS
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    moves = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = np.vstack([position_m, (position_m + lengths[:, None, None] * moves).reshape(-1, 2)])
    wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
    away = clearance_m(index, ends)
    low, high = np.reshape(problem.workspace.bounds_m, (2, 2))
    outside: Floats = np.linalg.norm(np.maximum(np.maximum(low - ends, ends - high), 0.0), axis=1)
    paths = np.repeat(ends[:, None], horizon + 1, axis=1)
    paths[:, 0] = position_m
    gap = paths_gap_m(moving, paths)
    deep, others = _inside_m(index, ends)
    static = np.maximum(wanted - away, 0.0) + outside + deep
    too_near_m = 0.0
    if len(moving):
        now_m = np.linalg.norm(position_m - moving.centres_m[:, 0], axis=-1)
        too_near_m = float(np.max(moving.apart_m[:, 0] - now_m, initial=0.0))
    if static[0] + too_near_m == 0.0:
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


def _inside_m(index: ObstacleIndex, places_m: Floats) -> tuple[Floats, ObstacleIndex]:
    """Return depths (n,) in the obstacles around the first position, and the other obstacles."""
    # The group contains the obstacles around the first position and all that intersect them.
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


def _too_near_m(moving: MovingDiscs, paths_m: Floats) -> Floats:
    """Return each path's largest shortfall (c,) of distance to moving discs, start excluded."""
    if not len(moving):
        return np.zeros(len(paths_m))
    places = int(paths_m.shape[1])
    centres, apart = moving.centres_m[:, 1:places], moving.apart_m[:, : places - 1]
    away = np.linalg.norm(paths_m[:, None, 1:] - centres, axis=-1)
    return np.maximum(apart - away, 0.0).max(axis=(1, 2))


DRAWN_STREAM = 3  # Number of the random stream for start positions
MOST_DRAWS = 10_000  # Maximum number of draws until a position or path is free


def with_drawn_starts(problem: Problem, seed: int) -> Problem:
    """Return the problem with drawn values for random starts of robots and targets."""
    spread = any(robot.start_spread_m > 0.0 for robot in problem.robots)
    moved = any(target.start_distance_m is not None for target in problem.targets)
    if not spread and not moved:
        return problem
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(DRAWN_STREAM,)))
    index = index_obstacles(problem.workspace)
    robots: list[Robot] = []
    for number in range(len(problem.robots)):
        robots.append(_drawn_robot(problem, index, number, robots, generator))
    targets = tuple(_drawn_target(problem, index, each, generator) for each in problem.targets)
    return replace(problem, robots=tuple(robots), targets=targets)


def _drawn_robot(
    problem: Problem,
    index: ObstacleIndex,
    number: int,
    before: Sequence[Robot],
    generator: np.random.Generator,
) -> Robot:
    robot, constraints = problem.robots[number], problem.constraints
    if robot.start_spread_m == 0.0:
        return robot
    fixed = [each for each in problem.robots[number + 1 :] if each.start_spread_m == 0.0]
    others = np.array([each.start_m for each in (*before, *fixed)]).reshape(-1, 2)
    for _ in range(MOST_DRAWS):
        angle, share = generator.uniform(0.0, 2.0 * np.pi), np.sqrt(generator.uniform())
        away = robot.start_spread_m * share * np.array([np.cos(angle), np.sin(angle)])
        place = np.asarray(robot.start_m) + away
        apart = np.linalg.norm(others - place, axis=1)
        if _is_free(problem, index, place[None], constraints.clearance_m) and (
            not len(apart) or apart.min() >= constraints.separation_m
        ):
            return replace(robot, start_m=(float(place[0]), float(place[1])), start_spread_m=0.0)
    raise InputError(
        f"is {robot.start_spread_m:g} m, but no free start position was found within this "
        f"distance of {list(robot.start_m)}",
        file=problem.file,
        key=f"robots[{number}].start_spread_m",
        remedy="increase it, or reduce constraints.separation_m",
    )


def _drawn_target(
    problem: Problem, index: ObstacleIndex, target: Target, generator: np.random.Generator
) -> Target:
    if target.start_distance_m is None:
        return target
    speed = float(np.hypot(*target.velocity_m_s))
    ahead_s = problem.planner.step_s * np.arange(problem.planner.max_steps + 1)
    for _ in range(MOST_DRAWS):
        angle = generator.uniform(0.0, 2.0 * np.pi)
        heading = angle + target.heading_spread_rad * generator.uniform(-1.0, 1.0)
        away = target.start_distance_m * np.array([np.cos(angle), np.sin(angle)])
        place = np.asarray(target.start_m) + away
        velocity = speed * np.array([np.cos(heading), np.sin(heading)])
        path = place + ahead_s[:, None] * velocity
        if not target.stays_free or _is_free(problem, index, path, 0.0):
            return replace(
                target,
                start_m=(float(place[0]), float(place[1])),
                velocity_m_s=(float(velocity[0]), float(velocity[1])),
                start_distance_m=None,
                heading_spread_rad=0.0,
            )
    raise InputError(
        "is true, but no straight target path was found that stays within the bounds and "
        f"clear of obstacles for {problem.planner.max_steps} steps",
        file=problem.file,
        key="targets[0].stays_free",
        remedy="reduce the target's speed or planner.max_steps, or enlarge world.bounds_m",
    )


def _is_free(problem: Problem, index: ObstacleIndex, places_m: Floats, clearance: float) -> bool:
    """Return whether all positions (n, 2) are in the workspace and keep `clearance`."""
    if not inside_bounds(problem.workspace, places_m).all():
        return False
    away = clearance_m(index, places_m)
    return bool((away >= clearance).all() and (away > 0.0).all())


def free_target_path(problem: Problem, draw_path: Callable[[], Floats]) -> Floats:
    """Return random states (n + 1, 4) of a target, outside obstacles if the target requires it."""
    if not problem.targets[0].stays_free:
        return draw_path()
    index = index_obstacles(problem.workspace)
    for _ in range(MOST_DRAWS):
        states = draw_path()
        if _is_free(problem, index, states[:, :2], 0.0):
            return states
    raise InputError(
        f"is true, but none of {MOST_DRAWS:,} random target paths stays within the bounds and "
        "clear of obstacles",
        file=problem.file,
        key="targets[0].stays_free",
        remedy="let the target start elsewhere or slower, or leave the key out",
    )


def free_places(problem: Problem, count: int, generator: np.random.Generator) -> Floats:
    """Return positions (count, 2) drawn uniformly from the free workspace."""
    index = index_obstacles(problem.workspace)
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    kept: list[Floats] = []
    found = 0
    for _ in range(1000):
        drawn = generator.uniform((x_min, y_min), (x_max, y_max), (max(2 * count, 64), 2))
        free = drawn[clearance_m(index, drawn) > 0.0]
        kept.append(free)
        found += len(free)
        if found >= count:
            return np.concatenate(kept)[:count]
    raise InputError(
        "leave no free position to measure at",
        file=problem.file,
        key="world.obstacles",
        remedy="remove some of them, or enlarge world.bounds_m",
    )
