"""The worst of several certificates, and how far robots keep apart step by step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.certificate import Certificate, dearest
from planopt.planning.rule_result import worst_result
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


def worst_of_robots(certificates: Mapping[str, Certificate]) -> Certificate:
    """The worst of robots' certificates, step by step; reasons say whose they are.

    Parameters
    ----------
    certificates
        By the robot's name.
    """
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
    residuals = [c.kkt_residual for c in all_of_them if c.kkt_residual is not None]
    return Certificate(
        min_clearance_m=min(c.min_clearance_m for c in all_of_them),
        min_connectivity=min(c.min_connectivity for c in all_of_them),
        dynamics_defect=max(c.dynamics_defect for c in all_of_them),
        kkt_residual=max(residuals, default=None),
        posterior=next((c.posterior for c in all_of_them if c.posterior != "exact"), "exact"),
        relaxed_steps=tuple(sorted(relaxation)),
        relaxation_db=tuple(relaxation[step] for step in sorted(relaxation)),
        best_margin_db=tuple(best[step] for step in sorted(best)),
        **dearest(all_of_them),
        reasons=tuple(
            f"{robot}: {reason}" for robot, c in certificates.items() for reason in c.reasons
        ),
        min_separation_m=least_of(c.min_separation_m for c in all_of_them),
        min_moving_clearance_m=least_of(c.min_moving_clearance_m for c in all_of_them),
        rule=worst_result(c.rule for c in all_of_them),
    )


def least_of(values: Iterable[float | None]) -> float | None:
    """The least of the numbers that there are; None if there is none."""
    return min((value for value in values if value is not None), default=None)
