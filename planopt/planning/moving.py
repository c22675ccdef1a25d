"""Moving obstacles over a plan's steps, and while robots brake after them."""

from __future__ import annotations

from planopt.problems.problem import Problem
from planopt.world.moving_obstacle import NOTHING_MOVES, MovingDiscs, predicted_discs


def steps_ahead(problem: Problem) -> int:
    """Steps for which it counts where everything is: planned ones, then the longest braking."""
    settings = problem.planner
    braking = [
        robot.dynamics.longest_stop_steps(settings.step_s)
        for robot in problem.robots
        if robot.dynamics is not None
    ]
    return settings.horizon + max(braking, default=0)


def obstacles_ahead(problem: Problem, driven: int) -> MovingDiscs:
    """Return the predicted discs over the steps ahead, after `driven` steps of a run.

    They are predicted anew at every step: what is not known of their way counts from then on.
    """
    if not problem.workspace.moving:
        return NOTHING_MOVES
    settings = problem.planner
    return predicted_discs(
        problem.workspace.moving,
        driven * settings.step_s,
        settings.step_s,
        steps_ahead(problem),
        problem.constraints.clearance_m,
    )
