"""The drive of a robot along a path, and its place at each time until it stands.

The single integrator, q+ = q + h v with a speed limit, drives straight within a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, listed
from planopt.parts import calling, class_name
from planopt.robots.dynamics import Dynamics
from planopt.world.timed_motion import TimedMotion


@dataclass(frozen=True, eq=False)
class Drive:
    """States and inputs over N steps.

    Attributes
    ----------
    dynamics
        Of the robot.
    states
        ``(N + 1, s)`` now and after each step, in the units of the dynamics' ``state_names``; the
        first two are x and y in metres.
    inputs
        ``(N, m)`` of each step, in the units of ``input_names``; constant over the step.
    """

    dynamics: Dynamics
    states: NDArray[np.float64]
    inputs: NDArray[np.float64]

    @property
    def positions_m(self) -> NDArray[np.float64]:
        """``(N + 1, 2)``."""
        return self.states[:, :2]


def rolled_out(
    dynamics: Dynamics,
    state: NDArray[np.float64],
    inputs: NDArray[np.float64],
    step_s: float,
) -> Drive:
    """Return where `inputs` (N, m) lead from `state` (s,)."""
    states = [np.asarray(state, dtype=np.float64)]
    for control in inputs:
        states.append(state_after(dynamics, states[-1], control, step_s))
    return Drive(dynamics, np.array(states), np.asarray(inputs, dtype=np.float64))


def state_after(
    dynamics: Dynamics, state: NDArray[np.float64], control: NDArray[np.float64], step_s: float
) -> NDArray[np.float64]:
    """Return the state (s,) after a step from a state (s,) with an input (m,)."""
    with calling(dynamics, "step"):
        after = np.array(dynamics.step(tuple(state), tuple(control), step_s), dtype=np.float64)
    given = np.concatenate([state, control])
    if after.shape != state.shape or (np.isfinite(given).all() and not np.isfinite(after).all()):
        raise InputError(
            f"{class_name(dynamics)}.step led from the state {state.tolist()} with the input "
            f"{np.asarray(control).tolist()} to {after.tolist()}",
            key="robots[].dynamics",
            remedy=f"return finite numbers for {listed(dynamics.state_names)}: divisions, roots "
            "and logarithms must be defined for all states and inputs within their bounds",
        )
    return after


def dynamics_defect_m(
    positions_m: NDArray[np.float64], start_m: NDArray[np.float64], step_length_m: float
) -> float:
    """Largest violation of the motion model over a path (n + 1, 2), in metres.

    The path must begin where the robot is, and no step may be longer than the speed allows.
    """
    lengths = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    jump = float(np.linalg.norm(positions_m[0] - start_m))
    # NumPy's maximum: Python's would lose a NaN.
    return float(np.max(lengths - step_length_m, initial=jump))


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
