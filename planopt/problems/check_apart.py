"""Robots start apart from each other and from what moves."""

from __future__ import annotations

import numpy as np

from planopt.errors import InputError
from planopt.problems.problem import Problem
from planopt.world.moving_obstacle import centres_at


def check_apart(problem: Problem) -> None:
    """Robots start apart from each other, and from where moving obstacles are at time 0."""
    separation = problem.constraints.separation_m
    _check_who_keeps_apart(problem)
    starts = np.array([robot.start_m for robot in problem.robots])
    for number, robot in enumerate(problem.robots):
        for other in range(number):
            distance = float(np.linalg.norm(starts[number] - starts[other]))
            if distance < separation:
                raise InputError(
                    f"is {list(robot.start_m)}, {distance:.3g} m from the start of "
                    f"{problem.robots[other].name}, less than the separation of {separation:g} m",
                    file=problem.file,
                    key=f"robots[{number}].start_m",
                    remedy="move it, or lessen constraints.separation_m",
                )
        for obstacle in problem.workspace.moving:
            centre = centres_at(obstacle, np.zeros(1))[0]
            distance = float(np.linalg.norm(starts[number] - centre)) - obstacle.radius_m
            if distance < problem.constraints.clearance_m:
                raise InputError(
                    f"is {list(robot.start_m)}, {distance:.3g} m from where the moving obstacle "
                    f"{obstacle.name} is at time 0, less than the clearance of "
                    f"{problem.constraints.clearance_m:g} m",
                    file=problem.file,
                    key=f"robots[{number}].start_m",
                    remedy="move it, or lessen constraints.clearance_m",
                )


def _check_who_keeps_apart(problem: Problem) -> None:
    """Distances at equal times are known of ways that are straight and even, not of others."""
    asked = "constraints.separation_m" if problem.constraints.separation_m else None
    asked = "world.moving" if problem.workspace.moving else asked
    for number, robot in enumerate(problem.robots):
        if asked is not None and robot.dynamics is not None:
            raise InputError(
                "is for robots that move straight and evenly in a step, which "
                f"robots[{number}] ({robot.name}) does not",
                file=problem.file,
                key=asked,
                remedy=f"leave it out, or use the dynamics single_integrator for {robot.name}",
            )
