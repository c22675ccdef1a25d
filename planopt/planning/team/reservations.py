"""What each robot keeps clear of while the others plan: the plans made, and what is reserved.

Robots plan one after the other. A robot's *reservation* is the rest of its last released plan, then
braking if it cannot stop at will, and standing where that ends for ever after; before the first
plan it is stopping from the start. Each plan, its own braking included, keeps the separation from
the plans already made in this step and from the reservations of the robots that have not planned
yet. So whatever a later robot finds, its own reservation stays clear
of all plans released before it, and can be released in place of a plan: if all reservations keep
apart when a step begins, they do when the next one begins. Load checks that the starts do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.moving import obstacles_ahead, steps_ahead
from planopt.planning.plan import Plan
from planopt.planning.proof.apart import judge_apart
from planopt.problems.problem import Problem
from planopt.robots.braked_motion import braked_motion, standing_motion
from planopt.world.moving_discs import MovingDiscs, joined_discs
from planopt.world.timed_motion import TimedMotion


def has_separation(problem: Problem) -> bool:
    """Return whether a problem's robots must keep apart."""
    return len(problem.robots) > 1 and problem.constraints.separation_m > 0.0


def reserved_path(
    position_m: NDArray[np.float64], last_path_m: NDArray[np.float64] | None, horizon: int
) -> NDArray[np.float64]:
    """Reserved by a robot that stops at will for its next N = `horizon` steps; ``(N + 1, 2)``.

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


def reserved_motion(
    problem: Problem, number: int, state: NDArray[np.float64], last: Plan | None
) -> TimedMotion:
    """What robot number `number` has reserved for the steps ahead.

    Parameters
    ----------
    problem
        With all robots.
    number
        Which robot.
    state
        ``(s,)`` its own, its place first.
    last
        The plan released one step ago; None before the first.
    """
    step_s, steps = problem.planner.step_s, steps_ahead(problem)
    if last is None:
        dynamics = problem.robots[number].dynamics
        return standing_motion(dynamics, state, step_s).lasting(steps)
    return planned_motion(problem, last).after(1).lasting(steps)


def planned_motion(problem: Problem, plan: Plan) -> TimedMotion:
    """A robot's plan, and stopping after it."""
    return braked_motion(plan.positions_m, plan.drive, problem.planner.step_s)


def beside(problem: Problem, driven: int, others: Mapping[int, TimedMotion]) -> MovingDiscs:
    """What a robot must keep from while it plans: moving obstacles, and robots where that is asked.

    Parameters
    ----------
    problem
        With all robots.
    driven
        Steps of the run before this one.
    others
        Plan or reservation of other robots, by number.
    """
    obstacles = obstacles_ahead(problem, driven)
    if not others or problem.constraints.separation_m == 0.0:
        return obstacles
    steps, count = steps_ahead(problem), len(others)
    motions = [motion.lasting(steps) for motion in others.values()]
    robots = MovingDiscs(
        tuple(problem.robots[number].name for number in others),
        np.array([motion.places_m for motion in motions]),
        np.zeros((count, steps)),
        np.full(count, problem.constraints.separation_m),
        np.ones(count, dtype=np.bool_),
        tuple(motion.ways for motion in motions),
    )
    return joined_discs(robots, obstacles)


def others_of(motions: Sequence[TimedMotion], number: int) -> dict[int, TimedMotion]:
    """The motions of all robots but number `number`, by number."""
    return {other: motion for other, motion in enumerate(motions) if other != number}


def beside_each_other(problem: Problem, driven: int, plans: Sequence[Plan]) -> list[Plan]:
    """The plans of one step with the separation that they keep from each other.

    While they were made, some of the others had only their reservations, or nothing at all.
    """
    motions = [planned_motion(problem, plan) for plan in plans]
    found: list[Plan] = []
    for number, plan in enumerate(plans):
        moving = beside(problem, driven, others_of(motions, number))
        apart = judge_apart(moving, motions[number], len(plan.positions_m) - 1)
        certificate = replace(plan.certificate, min_separation_m=apart.min_separation_m)
        found.append(replace(plan, certificate=certificate))
    return found
