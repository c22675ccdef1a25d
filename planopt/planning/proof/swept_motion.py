"""When a planned robot is where, for distances at equal times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.proof.motion import drive_fault
from planopt.problems.problem import Problem
from planopt.robots.braked_motion import braked_motion
from planopt.robots.drive import Drive
from planopt.world.timed_motion import TimedMotion


def swept_motion(
    problem: Problem, positions_m: NDArray[np.float64], drive: Drive | None
) -> TimedMotion:
    """When the problem's first robot is where, on a finite path and while it stops after it.

    Straight from place to place where `drive` can be none along the path, which the verifier
    objects to.
    """
    dynamics = problem.robots[0].dynamics
    if dynamics is None or drive is None or drive_fault(dynamics, positions_m, drive):
        return TimedMotion(positions_m)
    own = Drive(dynamics, drive.states, drive.inputs)
    return braked_motion(positions_m, own, problem.planner.step_s)
