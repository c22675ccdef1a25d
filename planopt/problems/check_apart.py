"""Robots start apart from each other and from what moves, and can stop apart from each other."""

from __future__ import annotations

import numpy as np

from planopt.errors import InputError
from planopt.problems.problem import Problem
from planopt.robots.braked_motion import standing_motion
from planopt.world.least_distance import CLOSE_M, step_distances_m
from planopt.world.moving_obstacle import centres_at


def check_apart(problem: Problem) -> None:
    """Robots start apart from each other, and from where moving obstacles are at time 0."""
    separation = problem.constraints.separation_m
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
            _check_stopping_apart(problem, number, other)
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


def _check_stopping_apart(problem: Problem, number: int, other: int) -> None:
    """Robots that move at the start keep apart if all stop, so that there is always a way out."""
    separation, step_s = problem.constraints.separation_m, problem.planner.step_s
    moving = {
        one: standing_motion(robot.dynamics, robot.start_state, step_s)
        for one, robot in ((one, problem.robots[one]) for one in (number, other))
    }
    steps = max(motion.steps for motion in moving.values())
    if separation == 0.0 or steps == 0:
        return
    distance = float(step_distances_m(moving[number], moving[other], steps).min())
    if distance + CLOSE_M < separation:
        fast, slow = (number, other) if moving[number].steps else (other, number)
        raise InputError(
            f"is {list(problem.robots[fast].start_rest)}: stopping from there leads within "
            f"{distance:.3g} m of {problem.robots[slow].name}, less than the separation of "
            f"{separation:g} m",
            file=problem.file,
            key=f"robots[{fast}].start_velocity_m_s",
            remedy="lessen it, start elsewhere, or lessen constraints.separation_m",
        )
