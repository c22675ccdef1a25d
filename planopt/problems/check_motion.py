"""A robot that cannot turn or stop at will: its start.

If it is moving at the start it must be able to stop: then there is always a clear plan.
"""

from __future__ import annotations

import math
from itertools import islice, product
from typing import cast

import numpy as np

from planopt.errors import InputError, listed
from planopt.parts import calling
from planopt.problems.problem import Problem
from planopt.robots.drive import state_after
from planopt.robots.dynamics import RestsByInput
from planopt.world.clearance import ObstacleIndex

REST_TOLERANCE_M = 1e-6
"""A robot that rests changes its state by no more than this in a step."""

MOST_CORNERS = 64
"""So many corners of the input set are tried at the start."""


def check_dynamics(problem: Problem) -> None:
    """Raise an error if some robot cannot be planned for as it moves."""
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


def check_own_map(problem: Problem, number: int) -> None:
    """Raise an error if the dynamics of robot number `number` cannot be driven."""
    robot, step_s = problem.robots[number], problem.planner.step_s
    dynamics, start = robot.dynamics, robot.start_state
    if dynamics is None:
        return
    key = f"robots[{number}].dynamics"
    with calling(dynamics, "braking", key=key):
        braking = dynamics.braking(start, step_s, 1)[0]
    inputs = [braking]
    if isinstance(dynamics, RestsByInput):
        bounds = [(low, high) for low, high in dynamics.input_bounds]
        finite = [tuple(filter(math.isfinite, pair)) or (0.0,) for pair in bounds]
        inputs += [np.array(one) for one in islice(product(*finite), MOST_CORNERS)]
    for control in inputs:
        try:
            state_after(dynamics, start, control, step_s)
        except InputError as error:
            raise InputError(error.message, key=key, remedy=error.remedy) from error
    if isinstance(dynamics, RestsByInput):
        change = np.abs(dynamics.change_at_rest(start, step_s) * dynamics.unit_m(step_s))
        if not float(change.max()) <= REST_TOLERANCE_M:
            raise InputError(
                f"{list(dynamics.rest_input)} does not let it rest: its state goes on changing, by "
                f"{float(change.max()):.3g} m a step, as far as a search finds",
                file=problem.file,
                key=f"{key}.rest_input",
                remedy="give the input with which it stays where it is; a function that is a "
                "derivative needs continuous = True",
            )


def check_stopping(problem: Problem, index: ObstacleIndex, number: int) -> None:
    """Raise an error if robot number `number` cannot brake in time from its start."""
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
