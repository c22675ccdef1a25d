"""How a robot drives along a path: its state after each step, and the input of each step.

Of the single integrator, q+ = q + h v with a speed limit, the way within a step is straight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.robots.dynamics import Dynamics


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
    """Where `inputs` (N, m) lead from `state` (s,)."""
    states = [np.asarray(state, dtype=np.float64)]
    for control in inputs:
        after = dynamics.step(tuple(states[-1]), tuple(control), step_s)
        states.append(np.array(after, dtype=np.float64))
    return Drive(dynamics, np.array(states), np.asarray(inputs, dtype=np.float64))


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
