"""Where a robot is at which time, while it follows a plan and while it then stops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.robots.drive import Drive, rolled_out
from planopt.robots.dynamics import Dynamics
from planopt.world.timed_motion import TimedMotion


def braked_motion(path_m: NDArray[np.float64], drive: Drive | None, step_s: float) -> TimedMotion:
    """The motion of a plan (N + 1, 2) and of braking after it, for as many steps as that takes.

    A robot without `drive` goes straight and evenly from place to place, and stops at will.
    """
    if drive is None:
        return TimedMotion(path_m)
    stop = braking_drive(drive.dynamics, drive.states[-1], step_s)
    states = np.vstack([drive.states, stop.states[1:]])
    inputs = np.vstack([drive.inputs, stop.inputs])
    return TimedMotion(
        np.vstack([path_m, stop.positions_m[1:]]),
        tuple(drive.dynamics.ways(states[:-1], inputs, step_s)),
    )


def braking_drive(dynamics: Dynamics, state: NDArray[np.float64], step_s: float) -> Drive:
    """Braking from `state` (s,), for as many steps as that takes; none where it stops at once."""
    steps = dynamics.stop_steps(state, step_s)
    return rolled_out(dynamics, state, dynamics.braking(state, step_s, steps), step_s)


def standing_motion(
    dynamics: Dynamics | None, state: NDArray[np.float64], step_s: float
) -> TimedMotion:
    """Stopping from `state` (s,), its place first, as soon as the robot can."""
    if dynamics is None:
        return TimedMotion(state[None, :2])
    return braked_motion(
        state[None, :2],
        Drive(dynamics, state[None], np.zeros((0, len(dynamics.input_names)))),
        step_s,
    )
