"""When a robot has arrived: it stands at the goal, or would come to stand there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import STANDSTILL_M
from planopt.problems.problem import Problem


def is_at_goal(problem: Problem, place_m: NDArray[np.float64]) -> bool:
    """Return whether a place (2,) is within the goal's radius."""
    away = float(np.linalg.norm(place_m - np.asarray(problem.goal_m)))
    return away <= problem.constraints.goal_radius_m


def stands(problem: Problem, state: NDArray[np.float64]) -> bool:
    """Return whether the first robot stands in a state (s,): braking does not move it.

    The single integrator always does.
    """
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    if dynamics is None:
        return True
    control = dynamics.braking(state, step_s, 1)[0]
    after = np.array(dynamics.step(tuple(state), tuple(control), step_s), dtype=np.float64)
    return float(np.linalg.norm(after[:2] - state[:2])) <= STANDSTILL_M


def stops_at_goal(problem: Problem, state: NDArray[np.float64]) -> bool:
    """Return whether a robot with dynamics is at the goal and comes to stand there if it brakes."""
    dynamics = problem.robots[0].dynamics
    if dynamics is None or not is_at_goal(problem, state[:2]):
        return False
    way = dynamics.stop_way(state, problem.planner.step_s)
    return stands(problem, state) if way is None else is_at_goal(problem, way.points_m()[0][-1])
