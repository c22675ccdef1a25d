"""How far robots keep from each other, and from moving obstacles, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.world.least_distance import step_distances_m
from planopt.world.moving_obstacle import predicted_discs
from planopt.world.timed_motion import TimedMotion


def least_separations_m(motions: Sequence[TimedMotion]) -> NDArray[np.float64]:
    """Least distance of any two robots during each step; ``(n,)`` of at least two motions."""
    steps = motions[0].steps
    return np.min([step_distances_m(a, b, steps) for a, b in combinations(motions, 2)], axis=0)


def least_moving_clearances_m(
    problem: Problem, motions: Sequence[TimedMotion]
) -> NDArray[np.float64]:
    """Least distance of any robot from any moving obstacle during each step of a run; ``(n,)``.

    From the discs as they are, not grown by what was unknown of their way when plans were made.
    """
    steps, clearance = motions[0].steps, problem.constraints.clearance_m
    obstacles = problem.workspace.moving
    discs = predicted_discs(obstacles, 0.0, problem.planner.step_s, steps, clearance)
    return np.min(
        [
            step_distances_m(motion, discs.motion(number), steps) - obstacle.radius_m
            for motion in motions
            for number, obstacle in enumerate(obstacles)
        ],
        axis=0,
    )


def driven_motion(track_m: NDArray[np.float64], drive: Drive | None, step_s: float) -> TimedMotion:
    """What was driven, or is planned, over the steps of a track (n + 1, 2) alone."""
    if drive is None:
        return TimedMotion(track_m)
    ways = drive.dynamics.ways(drive.states[:-1], drive.inputs, step_s)
    return TimedMotion(track_m, tuple(ways))
