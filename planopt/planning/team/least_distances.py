"""How far robots keep from each other, and from moving obstacles, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planopt.problems.problem import Problem
from planopt.world.closest_approach import closest_approach_m
from planopt.world.moving_discs import path_distances_m
from planopt.world.moving_obstacle import predicted_discs


def least_separations_m(tracks_m: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Least distance of any two robots during each step; ``(n,)`` of at least two tracks."""
    pairs = [closest_approach_m(a[:-1], a[1:], b[:-1], b[1:]) for a, b in combinations(tracks_m, 2)]
    return np.min(pairs, axis=0)


def least_moving_clearances_m(
    problem: Problem, tracks_m: Sequence[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Least distance of any robot from any moving obstacle during each step of a run; ``(n,)``.

    From the discs as they are, not grown by what was unknown of their way when plans were made.
    """
    steps, clearance = len(tracks_m[0]) - 1, problem.constraints.clearance_m
    discs = predicted_discs(problem.workspace.moving, 0.0, problem.planner.step_s, steps, clearance)
    sizes = np.array([[one.radius_m] for one in problem.workspace.moving])
    return np.min(
        [(path_distances_m(discs, track) - sizes).min(axis=0) for track in tracks_m], axis=0
    )
