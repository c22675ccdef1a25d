"""What each robot keeps clear of while the others plan: the plans made, and what is reserved.

Robots plan one after the other. A robot's *reservation* is the rest of its last released plan, and
standing at its end for ever after; before the first plan it is standing at the start. Each plan
keeps the separation from the plans already made in this step and from the reservations of the
robots that have not planned yet. So whatever a later robot finds, its own reservation stays clear
of all plans released before it, and can be released in place of a plan: if all reservations keep
apart when a step begins, they do when the next one begins. Load checks that the starts do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.moving import obstacles_ahead
from planopt.planning.plan import Plan
from planopt.planning.proof.apart import judge_apart
from planopt.problems.problem import Problem
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


def beside(
    problem: Problem, driven: int, others_m: Mapping[int, NDArray[np.float64]]
) -> MovingDiscs:
    """What a robot must keep from while it plans: moving obstacles, and robots where that is asked.

    Parameters
    ----------
    problem
        With all robots.
    driven
        Steps of the run before this one.
    others_m
        ``(N + 1, 2)`` plan or reservation of other robots, by number.
    """
    obstacles = obstacles_ahead(problem, driven)
    if not others_m or problem.constraints.separation_m == 0.0:
        return obstacles
    paths = np.array(list(others_m.values()))
    count, places = len(others_m), int(paths.shape[1])
    robots = MovingDiscs(
        tuple(problem.robots[number].name for number in others_m),
        paths,
        np.zeros((count, places - 1)),
        np.full(count, problem.constraints.separation_m),
        np.ones(count, dtype=np.bool_),
    )
    return joined_discs(robots, obstacles)


def others_of(
    paths_m: Sequence[NDArray[np.float64]], number: int
) -> dict[int, NDArray[np.float64]]:
    """The paths of all robots but number `number`, by number."""
    return {other: path for other, path in enumerate(paths_m) if other != number}


def beside_each_other(problem: Problem, driven: int, plans: Sequence[Plan]) -> list[Plan]:
    """The plans of one step with the separation that they keep from each other.

    While they were made, some of the others had only their reservations, or nothing at all.
    """
    paths = [plan.positions_m for plan in plans]
    found: list[Plan] = []
    for number, plan in enumerate(plans):
        moving = beside(problem, driven, others_of(paths, number))
        apart = judge_apart(moving, plan.positions_m)
        certificate = replace(plan.certificate, min_separation_m=apart.min_separation_m)
        found.append(replace(plan, certificate=certificate))
    return found
