"""Reservations that robots keep clear of while others plan, and how far their plans keep apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.certificate import Certificate, worst_of
from planopt.planning.plan import Plan
from planopt.planning.proof.context import obstacles_ahead, steps_ahead
from planopt.planning.proof.motion import verify_apart
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive, braked_motion, stopping_motion
from planopt.world.motion import TimedMotion, step_distances_m
from planopt.world.moving_discs import MovingDiscs, joined_discs, predicted_discs


def has_separation(problem: Problem) -> bool:
    """Return whether a problem's robots must keep apart."""
    return len(problem.robots) > 1 and problem.constraints.separation_m > 0.0


def reserved_path(
    position_m: NDArray[np.float64], last_path_m: NDArray[np.float64] | None, horizon: int
) -> NDArray[np.float64]:
    """Reserved by a robot that stops at will for its next N = `horizon` steps; ``(N + 1, 2)``."""
    # Shapes: position_m (2,); last_path_m (N + 1, 2).
    if last_path_m is None:
        return np.tile(position_m, (horizon + 1, 1))
    return np.vstack([last_path_m[1:], last_path_m[-1:]])


def reserved_motion(
    problem: Problem, number: int, state: NDArray[np.float64], last: Plan | None
) -> TimedMotion:
    """Return what robot number `number` has reserved for the steps ahead."""
    # Shapes: state (s,).
    step_s, steps = problem.planner.step_s, steps_ahead(problem)
    if last is None:
        dynamics = problem.robots[number].dynamics
        return stopping_motion(dynamics, state, step_s).lasting(steps)
    return planned_motion(problem, last).after(1).lasting(steps)


def planned_motion(problem: Problem, plan: Plan) -> TimedMotion:
    """A robot's plan, and stopping after it."""
    return braked_motion(plan.positions_m, plan.drive, problem.planner.step_s)


def beside(problem: Problem, driven: int, others: Mapping[int, TimedMotion]) -> MovingDiscs:
    """Return the discs to keep from: moving obstacles, and robots where that is asked."""
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
        apart = verify_apart(moving, motions[number], len(plan.positions_m) - 1)
        certificate = replace(plan.certificate, min_separation_m=apart.min_separation_m)
        found.append(replace(plan, certificate=certificate))
    return found


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
    """Return what was driven, or is planned, over the steps of a track (n + 1, 2) alone."""
    if drive is None:
        return TimedMotion(track_m)
    curves = drive.dynamics.curves(drive.states[:-1], drive.inputs, step_s)
    return TimedMotion(track_m, tuple(curves))


def worst_of_robots(certificates: Mapping[str, Certificate]) -> Certificate:
    """The worst of robots' certificates, step by step; reasons say whose they are."""
    all_of_them = tuple(certificates.values())
    if len(all_of_them) == 1:
        return all_of_them[0]
    missed = [c for c in all_of_them if c.relaxed_steps]
    relaxation: dict[int, float] = {}
    best: dict[int, float] = {}
    for c in missed:
        for step, missing_db in zip(c.relaxed_steps, c.relaxation_db, strict=True):
            relaxation[step] = max(missing_db, relaxation.get(step, 0.0))
        for step, margin_db in zip(c.relaxed_steps, c.best_margin_db, strict=False):
            best[step] = min(margin_db, best.get(step, margin_db))
    return replace(
        worst_of(all_of_them),
        relaxed_steps=tuple(sorted(relaxation)),
        relaxation_db=tuple(relaxation[step] for step in sorted(relaxation)),
        best_margin_db=tuple(best[step] for step in sorted(best)),
        reasons=tuple(
            f"{robot}: {reason}" for robot, c in certificates.items() for reason in c.reasons
        ),
    )
