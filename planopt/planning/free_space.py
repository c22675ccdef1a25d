"""Whether the free space joins start and goal, exactly, and how much clearance it leaves."""

from __future__ import annotations

import shapely

from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.problems.problem import Problem
from planopt.world.workspace import Obstacle

BISECTIONS = 30
"""The widest clearance is found to this many bits."""


def is_joined(problem: Problem, clearance_m: float, without: Obstacle | None = None) -> bool:
    """Whether a way from start to goal keeps a clearance.

    Parameters
    ----------
    problem
        A problem that is to reach a goal.
    clearance_m
        The clearance in metres.
    without
        An obstacle that is left out.
    """
    free = shapely.box(*problem.workspace.bounds_m)
    for obstacle in problem.workspace.obstacles:
        if obstacle is not without:
            free = free.difference(obstacle.polygon.buffer(clearance_m))
    start, goal = shapely.Point(problem.robots[0].start_m), shapely.Point(problem.goal_m)
    # Both may lie on the very edge of what the clearance leaves.
    return any(
        part.distance(start) <= CLEARANCE_PAD_M and part.distance(goal) <= CLEARANCE_PAD_M
        for part in shapely.get_parts(free)
        if isinstance(part, shapely.Polygon) and not part.is_empty
    )


def widest_clearance_m(problem: Problem) -> float | None:
    """The largest clearance up to the problem's with which a way to the goal is left.

    None where there is no way at all.
    """
    if not is_joined(problem, 0.0):
        return None
    low, high = 0.0, problem.constraints.clearance_m
    if is_joined(problem, high):
        return high
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if is_joined(problem, middle):
            low = middle
        else:
            high = middle
    return low
