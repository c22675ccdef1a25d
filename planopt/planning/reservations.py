"""Reservations: motions that all other robots avoid, and distances between robots.

The *reservation* of a robot is the remainder of its last released plan, then braking and waiting;
before the first plan, it is braking from the start. Every robot can follow its reservation instead
of a new plan, and separated reservations stay separated in the next step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from planopt.arrays import Floats
from planopt.planning.certificate import plan_message
from planopt.planning.plan import Plan, Verdict
from planopt.planning.proof.motion import verify_apart
from planopt.planning.proof.rule import obstacles_ahead, steps_ahead
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, braked_motion, stopping_motion
from planopt.world.motion import (
    MovingDiscs,
    TimedMotion,
    joined_discs,
    predicted_discs,
    step_distances_m,
)


def reserved_path(position_m: Floats, last_path_m: Floats | None, horizon: int) -> Floats:
    """Return the reserved positions ``(N + 1, 2)`` of a single integrator over the horizon."""
    # Shapes: position_m (2,); last_path_m (N + 1, 2).
    if last_path_m is None:
        return np.tile(position_m, (horizon + 1, 1))
    return np.vstack([last_path_m[1:], last_path_m[-1:]])


def reserved_motion(problem: Problem, number: int, state: Floats, last: Plan | None) -> TimedMotion:
    """Return the motion reserved by robot `number`: its last plan's remainder, then braking."""
    step_s, steps = problem.planner.step_s, steps_ahead(problem)
    if last is None:
        dynamics = problem.robots[number].dynamics
        return stopping_motion(dynamics, state, step_s).lasting(steps)
    return planned_motion(problem, last).after(1).lasting(steps)


def planned_motion(problem: Problem, plan: Plan) -> TimedMotion:
    """Return the motion of a plan, including braking after it."""
    return braked_motion(plan.positions_m, plan.drive, problem.planner.step_s)


def discs_to_avoid(problem: Problem, driven: int, others: Mapping[int, TimedMotion]) -> MovingDiscs:
    """Return moving obstacles and, if a separation is required, other robots as moving discs."""
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
        tuple(motion.curves for motion in motions),
    )
    return joined_discs(robots, obstacles)


def others_of(motions: Sequence[TimedMotion], number: int) -> dict[int, TimedMotion]:
    """Return the motions of all robots except robot `number`, by robot number."""
    return {other: motion for other, motion in enumerate(motions) if other != number}


def with_separations(problem: Problem, driven: int, plans: Sequence[Plan]) -> list[Plan]:
    """Return the plans of one step, with the robots' mutual separations in their certificates."""
    # A plan made first is verified before the others; a planner of the user may come too close.
    motions = [planned_motion(problem, plan) for plan in plans]
    found: list[Plan] = []
    for number, plan in enumerate(plans):
        moving = discs_to_avoid(problem, driven, others_of(motions, number))
        apart = verify_apart(moving, motions[number], len(plan.positions_m) - 1)
        certificate = replace(plan.certificate, min_separation_m=apart.min_separation_m)
        if apart.reasons and plan.verdict in (Verdict.VERIFIED, Verdict.FEASIBLE_UNVERIFIED):
            certificate = replace(certificate, reasons=apart.reasons)
            message = plan_message(certificate, plan.positions_m)
            plan = replace(plan, verdict=Verdict.VIOLATED, message=message)
        found.append(replace(plan, certificate=certificate))
    return found


def least_separations_m(motions: Sequence[TimedMotion]) -> Floats:
    """Return the minimum distance ``(n,)`` between any two robots in each step."""
    steps = motions[0].steps
    return np.min([step_distances_m(a, b, steps) for a, b in combinations(motions, 2)], axis=0)


def least_moving_clearances_m(problem: Problem, motions: Sequence[TimedMotion]) -> Floats:
    """Return the minimum true distances ``(n,)`` of robots to moving obstacles, by step."""
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


def driven_motion(track_m: Floats, drive: Drive | None, step_s: float) -> TimedMotion:
    """Return the motion over the steps of a track (n + 1, 2), without braking after it."""
    if drive is None:
        return TimedMotion(track_m)
    return TimedMotion(
        track_m, tuple(drive.dynamics.curves(drive.states[:-1], drive.inputs, step_s))
    )
