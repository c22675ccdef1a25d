"""Drives: the states and inputs of a robot along a path, and its motion until it stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, listed
from planopt.parts import calling, class_name
from planopt.robots.dynamics import Dynamics
from planopt.world.motion import TimedMotion


@dataclass(frozen=True, eq=False)
class Drive:
    """States and inputs over N steps.

    Attributes
    ----------
    dynamics
        Dynamics of the robot.
    states
        ``(N + 1, s)`` states now and after each step, in the units of ``state_names``; the first
        two components are x and y in metres.
    inputs
        ``(N, m)`` inputs of each step, in the units of ``input_names``.
    """

    dynamics: Dynamics
    states: NDArray[np.float64]
    inputs: NDArray[np.float64]

    @property
    def positions_m(self) -> NDArray[np.float64]:
        """``(N + 1, 2)`` positions of the states."""
        return self.states[:, :2]


def rolled_out(
    dynamics: Dynamics,
    state: NDArray[np.float64],
    inputs: NDArray[np.float64],
    step_s: float,
) -> Drive:
    """Return the drive that `inputs` (N, m) cause from `state` (s,)."""
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
    """Return the largest violation of the single integrator over a path (n + 1, 2), in metres.

    The path must begin where the robot is, and no step may be longer than the speed allows.
    """
    lengths = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    jump = float(np.linalg.norm(positions_m[0] - start_m))
    # NumPy's maximum: Python's would lose a NaN.
    return float(np.max(lengths - step_length_m, initial=jump))


def braked_motion(path_m: NDArray[np.float64], drive: Drive | None, step_s: float) -> TimedMotion:
    """Return the motion of a plan (N + 1, 2) and of braking after it.

    Without `drive` it is straight and even during each step, and ends with the plan.
    """
    if drive is None:
        return TimedMotion(path_m)
    stop = braking_drive(drive.dynamics, drive.states[-1], step_s)
    states = np.vstack([drive.states, stop.states[1:]])
    inputs = np.vstack([drive.inputs, stop.inputs])
    return TimedMotion(
        np.vstack([path_m, stop.positions_m[1:]]),
        tuple(drive.dynamics.curves(states[:-1], inputs, step_s)),
    )


def braking_drive(dynamics: Dynamics, state: NDArray[np.float64], step_s: float) -> Drive:
    """Return the braking drive from `state` (s,); of no step where it stops at once."""
    steps = dynamics.stop_steps(state, step_s)
    return rolled_out(dynamics, state, dynamics.braking(state, step_s, steps), step_s)


def stopping_motion(dynamics: Dynamics, state: NDArray[np.float64], step_s: float) -> TimedMotion:
    """Return the motion of a robot that stops from `state` (s,) as soon as it can."""
    resting = Drive(dynamics, state[None], np.zeros((0, len(dynamics.input_names))))
    return braked_motion(state[None, :2], resting, step_s)
