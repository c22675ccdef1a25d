"""What each robot keeps clear of while the others plan: the plans made, and what is reserved.

Robots plan one after the other. A robot's *reservation* is the rest of its last released plan, and
standing at its end for ever after; before the first plan it is standing at the start. Each plan
keeps the separation from the plans already made in this step and from the reservations of the
robots that have not planned yet. So whatever a later robot finds, its own reservation stays clear
of all plans released before it, and can be released in place of a plan: if all reservations keep
apart when a step begins, they do when the next one begins. Load checks that the starts do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.moving import obstacles_ahead
from planopt.problems.problem import Problem
from planopt.world.closest_approach import closest_approach_m
from planopt.world.moving_discs import MovingDiscs, joined_discs


def reserved_path(
    position_m: NDArray[np.float64], last_path_m: NDArray[np.float64] | None, horizon: int
) -> NDArray[np.float64]:
    """What a robot has reserved for its next N = `horizon` steps; ``(N + 1, 2)``.

    Parameters
    ----------
    position_m
        ``(2,)`` where it is.
    last_path_m
        ``(N + 1, 2)`` the plan released one step ago; None before the first.
    horizon
        N.
    """
    if last_path_m is None:
        return np.tile(position_m, (horizon + 1, 1))
    return np.vstack([last_path_m[1:], last_path_m[-1:]])


def moving_for(
    problem: Problem,
    number: int,
    driven: int,
    made_m: Sequence[NDArray[np.float64]],
    reserved_m: Sequence[NDArray[np.float64]],
) -> MovingDiscs:
    """What robot number `number` must keep from while it plans.

    Parameters
    ----------
    problem
        With all robots.
    number
        Whose plan is next; those before it have planned.
    driven
        Steps of the run before this one.
    made_m
        ``(N + 1, 2)`` plans made in this step, of the first robots.
    reserved_m
        ``(N + 1, 2)`` reservations of all robots.
    """
    obstacles = obstacles_ahead(problem, driven)
    separation = problem.constraints.separation_m
    others = [other for other in range(len(problem.robots)) if other != number]
    if separation == 0.0 or not others:
        return obstacles
    paths = np.array([made_m[n] if n < number else reserved_m[n] for n in others])
    robots = MovingDiscs(
        tuple(problem.robots[n].name for n in others),
        paths,
        np.zeros((len(others), int(paths.shape[1]) - 1)),
        np.full(len(others), separation),
        np.ones(len(others), dtype=np.bool_),
    )
    return joined_discs(robots, obstacles)


def least_separation_m(paths_m: Sequence[NDArray[np.float64]]) -> float | None:
    """Least distance of any two paths (n, 2) at equal times, all the way; None of a single one."""
    return min(
        (
            float(closest_approach_m(a[:-1], a[1:], b[:-1], b[1:]).min())
            for row, a in enumerate(paths_m)
            for b in paths_m[:row]
        ),
        default=None,
    )
