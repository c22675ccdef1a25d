"""A robot that cannot turn or stop at will: its start.

If it is moving at the start it must be able to stop: then there is always a clear plan.
"""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from planopt.errors import InputError, listed
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex


def check_dynamics(problem: Problem) -> None:
    """Raise an error if some robot cannot be planned for as it moves.

    Raises
    ------
    InputError
        Its start is no state of its dynamics.
    """
    for number, robot in enumerate(problem.robots):
        dynamics = robot.dynamics
        if dynamics is None:
            continue
        rest = dynamics.state_names[2:]
        given = robot.start_rest
        values = cast("tuple[object]", given) if isinstance(cast("object", given), tuple) else ()
        numbers = all(isinstance(value, int | float) and math.isfinite(value) for value in values)
        if not isinstance(cast("object", given), tuple) or len(values) != len(rest) or not numbers:
            raise InputError(
                f"has the start_rest {given!r}, should have finite numbers for {listed(rest)}",
                file=problem.file,
                key=f"robots[{number}]",
                remedy=f"start_rest is the state of a {dynamics.kind} beyond its place",
            )


def check_stopping(problem: Problem, index: ObstacleIndex, number: int) -> None:
    """Raise an error if robot number `number` cannot brake in time from its start.

    Raises
    ------
    InputError
        The way of braking comes too near to an obstacle or leaves the bounds.
    """
    robot = problem.robots[number]
    if robot.dynamics is None:
        return
    way = robot.dynamics.stop_way(robot.start_state, problem.planner.step_s)
    if way is None:
        return
    places, within = way.points_m()
    bounds = np.array(problem.workspace.bounds_m)
    outside = (places - within < bounds[:2]).any() or (places + within > bounds[2:]).any()
    if outside or way.clearance_m(index) < problem.constraints.clearance_m:
        raise InputError(
            f"is {list(robot.start_rest)}, too fast to stop "
            + ("within world.bounds_m" if outside else "clear of the obstacles ahead"),
            file=problem.file,
            key=f"robots[{number}].start_velocity_m_s",
            remedy="lessen it, or start elsewhere",
        )
