"""Draw places from a seed: starts of robots and of a target, its path, and measured places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.problems.problem import Problem
from planopt.problems.robot import Robot
from planopt.problems.target import Target
from planopt.world.clearance import ObstacleIndex, clearance_m, index_obstacles, inside_bounds

DRAWN_STREAM = 3
"""Random stream of starts; ground truth, measurements and robots have others."""

MOST_DRAWS = 10_000
"""Limit of the number of draws of a place or path."""


def with_drawn_starts(problem: Problem, seed: int) -> Problem:
    """Return the problem with drawn starts of robots and target, if it asks for them."""
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
        f"leaves no free place within {robot.start_spread_m:g} m of {list(robot.start_m)}",
        file=problem.file,
        key=f"robots[{number}].start_spread_m",
        remedy="widen it, or lessen constraints.separation_m",
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
        "finds no straight path that stays within the bounds and out of obstacles for "
        f"{problem.planner.max_steps} steps",
        file=problem.file,
        key="targets[0].stays_free",
        remedy="lessen the target's speed or planner.max_steps, or widen world.bounds_m",
    )


def _is_free(
    problem: Problem, index: ObstacleIndex, places_m: NDArray[np.float64], clearance: float
) -> bool:
    """Return whether all places (n, 2) are in the workspace, with this clearance."""
    if not inside_bounds(problem.workspace, places_m).all():
        return False
    away = clearance_m(index, places_m)
    return bool((away >= clearance).all() and (away > 0.0).all())


def free_target_path(
    problem: Problem, draw_path: Callable[[], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Draw a target's states (n + 1, 4), again until they are free if the problem asks for it."""
    if not problem.targets[0].stays_free:
        return draw_path()
    index = index_obstacles(problem.workspace)
    for _ in range(MOST_DRAWS):
        states = draw_path()
        if _is_free(problem, index, states[:, :2], 0.0):
            return states
    raise InputError(
        f"finds none in {MOST_DRAWS:,} paths that stays within the bounds and out of obstacles",
        file=problem.file,
        key="targets[0].stays_free",
        remedy="let it start elsewhere or slower, or leave the key out",
    )


def free_places(
    problem: Problem, count: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Draw `count` places uniformly from the workspace outside obstacles; (count, 2)."""
    index = index_obstacles(problem.workspace)
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    kept: list[NDArray[np.float64]] = []
    found = 0
    for _ in range(1000):
        drawn = generator.uniform((x_min, y_min), (x_max, y_max), (max(2 * count, 64), 2))
        free = drawn[clearance_m(index, drawn) > 0.0]
        kept.append(free)
        found += len(free)
        if found >= count:
            return np.concatenate(kept)[:count]
    raise InputError(
        "the obstacles leave no place to measure at",
        file=problem.file,
        key="world.obstacles",
        remedy="remove some, or widen world.bounds_m",
    )
