"""What moves over a plan's steps: the problem's moving obstacles."""

from __future__ import annotations

from planopt.problems.problem import Problem
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs
from planopt.world.moving_obstacle import predicted_discs


def obstacles_ahead(problem: Problem, driven: int) -> MovingDiscs:
    """Where moving obstacles are predicted over the horizon, after `driven` steps of a run.

    They are predicted anew at every step: what is not known of their way counts from then on.
    """
    if not problem.workspace.moving:
        return NOTHING_MOVES
    settings = problem.planner
    return predicted_discs(
        problem.workspace.moving,
        driven * settings.step_s,
        settings.step_s,
        settings.horizon,
        problem.constraints.clearance_m,
    )
