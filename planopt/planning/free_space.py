"""Free space: whether it joins start and goal, and which places and ways are outside it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_PAD_M, CLEARANCE_TOLERANCE_M
from planopt.problems.problem import Problem
from planopt.world.clearance import (
    ObstacleIndex,
    containing_obstacle,
    is_clear,
    segment_lines,
    swept_clearance_m,
)
from planopt.world.workspace import Obstacle

BISECTIONS = 16
"""The widest clearance is found to this many bits."""


def is_joined(problem: Problem, clearance_m: float, without: Obstacle | None = None) -> bool:
    """Return whether a way from start to goal keeps a clearance."""
    polygons = [each.polygon for each in problem.workspace.obstacles if each is not without]
    covered = shapely.union_all(shapely.buffer(polygons, clearance_m))
    free = shapely.box(*problem.workspace.bounds_m).difference(covered)
    start, goal = shapely.Point(problem.robots[0].start_m), shapely.Point(problem.goal_m)
    # Both may lie on the very edge of what the clearance leaves.
    return any(
        part.distance(start) <= CLEARANCE_PAD_M and part.distance(goal) <= CLEARANCE_PAD_M
        for part in shapely.get_parts(free)
        if isinstance(part, shapely.Polygon) and not part.is_empty
    )


def widest_clearance_m(
    problem: Problem, is_over: Callable[[], bool] = lambda: False
) -> float | None:
    """Return the largest clearance below the problem's that leaves a path to the goal.

    Bisection ends early once `is_over`. Return None if there is no path at all.
    """
    if not is_joined(problem, 0.0):
        return None
    low, high = 0.0, problem.constraints.clearance_m
    for _ in range(BISECTIONS):
        if is_over():
            break
        middle = 0.5 * (low + high)
        if is_joined(problem, middle):
            low = middle
        else:
            high = middle
    return low


def obstacles_met(
    problem: Problem, index: ObstacleIndex, path_m: NDArray[np.float64], first: int = 0
) -> list[str]:
    """A reason for every place (n, 2) of a path, and every way between, that is not clear.

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
            f"step {first + segment + 1}: the way there comes within {clearance[segment]:.3f} m of "
            f"obstacle {nearest.name}"
        )
    return reasons
