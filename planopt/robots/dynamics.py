"""Interface of robot dynamics for planners and verifier, and simulated trajectories.

One formula serves NumPy scalars, NumPy arrays of any shape and CasADi expressions.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.errors import InputError, listed
from planopt.parts import calling, class_name
from planopt.world.motion import StepCurve, TimedMotion

Components = tuple[Any, ...]
"""Components of a state or an input: numbers, arrays or expressions."""


@dataclass(frozen=True)
class Disc:
    """Disc constraint: the magnitude of two state or input components is at most a radius."""

    limit: int  # Index of the constraint among the limits
    names: tuple[str, ...]  # Names of the two components, of the next state or the input
    radius: float  # Largest magnitude of the pair


class Dynamics(Protocol):
    """Protocol of a robot's dynamics: motion, limits, braking and turning.

    A class may derive from it to inherit the defaults: interval limits, exact hulls, and a robot
    that stops at once.
    """

    kind: str
    """Name of the dynamics in problem files."""
    state_names: tuple[str, ...]
    """Names of the state components with units; the first two are ``x_m`` and ``y_m``."""
    input_names: tuple[str, ...]
    """Names of the input components with units."""
    speed_max_m_s: float
    """Largest speed in m/s."""

    @property
    def discs(self) -> tuple[Disc, ...]:
        """Limits that are disc constraints."""
        return ()

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """Return the state after a step."""
        ...

    def limits(self, control: Components, after: Components) -> Components:
        """Return scaled values g of the limits g <= 0 on a step's input and the state after it."""
        ...

    def control_points(
        self, state: Components, control: Components, step_s: float
    ) -> tuple[tuple[Any, Any], ...]:
        """Return points whose convex hull, with both ends of a step, contains its path."""
        ...

    def hull_pad_m(self, step_s: float) -> float:
        """Return the largest distance of a step's path from the hull of :meth:`control_points`."""
        return 0.0

    def timed_pad_m(self, step_s: float) -> float:
        """Return the largest distance of a robot from the step's Bezier curve at equal times."""
        return 0.0

    def stop_points(self, state: Components, step_s: float) -> tuple[tuple[Any, Any], ...]:
        """Return points whose convex hull, with the position, contains the braking path."""
        return ()

    def stop_curve(self, state: Floats, step_s: float) -> StepCurve | None:
        """Return the braking path from a state; None if the robot stops at once."""
        return None

    def stop_rows(self, state: Components, step_s: float) -> Components:
        """Return expressions that are 0 if the robot can stop from a state; () if it always can."""
        return ()

    def stop_steps(self, state: Floats, step_s: float) -> int:
        """Return the number of steps of :meth:`braking` until standstill."""
        return 0

    def longest_stop_steps(self, step_s: float) -> int:
        """Return the maximum of :meth:`stop_steps` over all states within the limits."""
        return 0

    def resting_place(self, state: Components) -> tuple[Any, Any]:
        """Return the approximate position (x, y) of rest after braking, smooth in the state."""
        return state[0], state[1]

    def turning_s(self, state: Components, place: tuple[Any, Any]) -> Any:
        """Return a smooth estimate of the time to turn towards a position; 0 at the position."""
        return 0.0

    def braking(self, state: Floats, step_s: float, steps: int) -> Floats:
        """Return inputs (steps, m) that stop as soon as possible and then rest."""
        return np.zeros((steps, 2))

    def following(self, state: Floats, path_m: Floats, step_s: float) -> Floats:
        """Return inputs (N, m) that approximately follow a path (N, 2) of straight steps."""
        ...

    def straight(self, state: Floats, end_m: Floats, step_s: float) -> Floats | None:
        """Return inputs (k, m) for a straight drive to rest at `end_m`; None if unknown."""
        ...

    def may_reach(self, state: Floats, places_m: Floats, duration_s: float, slack_m: float) -> Mask:
        """Return a mask (n,) of positions that may be reached within `slack_m` in `duration_s`."""
        return np.ones(len(places_m), dtype=np.bool_)

    def curves(self, states: Floats, inputs: Floats, step_s: float) -> list[StepCurve]:
        """Return the paths of steps from states (n, s) with inputs (n, m)."""
        ...

    def excess_m(self, states: Floats, inputs: Floats, step_s: float) -> float:
        """Return the largest violation of input or speed limits, in metres per step."""
        ...

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """Return the displacement per step in metres caused by a unit of each state component."""
        ...


NO_DEFAULT = (
    *("step", "limits", "control_points", "following", "straight", "curves", "excess_m", "unit_m"),
)
"""Methods of dynamics that have no default."""


@runtime_checkable
class RestsByInput(Protocol):
    """Protocol of dynamics with input bounds and an input that keeps the robot at rest."""

    rest_input: tuple[float, ...]
    input_bounds: tuple[tuple[float, float], ...]

    def change_at_rest(self, state: Floats, step_s: float) -> Floats:
        """Return the smallest state change (s,) under the rest input at the position of `state`."""
        ...


class PurePursuit:
    """Pure pursuit of a path: look-ahead points and speeds, with monotone progress."""

    def __init__(self, path_m: Floats) -> None:
        lengths = np.linalg.norm(np.diff(path_m, axis=0), axis=1)
        self._path_m = path_m
        self._along_m = np.concatenate([[0.0], np.cumsum(lengths)])
        self._at_m = 0.0
        legs = np.diff(path_m, axis=0)[lengths > 0.0]
        along = legs / np.linalg.norm(legs, axis=1)[:, None]
        # Norm of the change of direction, 2 sin(turn / 2).
        self._turn = np.linalg.norm(np.diff(along, axis=0), axis=1)
        self._corner_m = np.cumsum(lengths[lengths > 0.0])

    def ahead_m(self, place_m: Floats, lookahead_m: float) -> tuple[Floats, float]:
        """Return the look-ahead point (2,) from `place_m` (2,), and the remaining path length."""
        along = np.linspace(self._at_m, self._at_m + 1.5 * lookahead_m, 33)
        away = np.linalg.norm(self._points(along) - place_m, axis=1)
        self._at_m = float(min(along[int(away.argmin())], self._along_m[-1]))
        target = self._points(np.array([self._at_m + lookahead_m]))[0]
        return target, float(self._along_m[-1] - self._at_m)

    def speed_m_s(self, acceleration_m_s2: float, swing_m: float) -> float:
        """Return the largest speed that permits the turns ahead and a stop at the end."""
        turn = np.append(self._turn, np.inf)[-len(self._corner_m) :]
        # A turn takes turn v / a seconds, in which the robot drives twice `swing_m`.
        square = 2.0 * acceleration_m_s2 * swing_m / np.maximum(turn, 1e-9)
        left = self._corner_m - self._at_m
        square = square + 2.0 * acceleration_m_s2 * np.maximum(left, 0.0)
        ahead = left > -1e-9
        return float(np.sqrt(square[ahead].min())) if ahead.any() else 0.0

    def _points(self, along_m: Floats) -> Floats:
        return np.column_stack(
            [np.interp(along_m, self._along_m, self._path_m[:, axis]) for axis in (0, 1)]
        )


@dataclass(frozen=True, eq=False)
class Drive:
    """State and input trajectory over N steps.

    Attributes
    ----------
    dynamics
        Dynamics of the robot.
    states
        ``(N + 1, s)`` states now and after each step, in the units of ``state_names``; the first
        two components are x and y in metres.
    inputs
        ``(N, m)`` input of each step, in the units of ``input_names``.
    """

    dynamics: Dynamics
    states: Floats
    inputs: Floats

    @property
    def positions_m(self) -> Floats:
        """``(N + 1, 2)`` positions of the states."""
        return self.states[:, :2]


def rolled_out(dynamics: Dynamics, state: Floats, inputs: Floats, step_s: float) -> Drive:
    """Return the simulated drive from `state` (s,) under `inputs` (N, m)."""
    states = [np.asarray(state, dtype=np.float64)]
    for control in inputs:
        states.append(state_after(dynamics, states[-1], control, step_s))
    return Drive(dynamics, np.array(states), np.asarray(inputs, dtype=np.float64))


def state_after(dynamics: Dynamics, state: Floats, control: Floats, step_s: float) -> Floats:
    """Return the state (s,) after one step from `state` (s,) under input `control` (m,)."""
    with calling(dynamics, "step"):
        after = np.array(dynamics.step(tuple(state), tuple(control), step_s), dtype=np.float64)
    given = np.concatenate([state, control])
    if after.shape != state.shape or (np.isfinite(given).all() and not np.isfinite(after).all()):
        raise InputError(
            f"{class_name(dynamics)}.step returned {after.tolist()} for the state "
            f"{state.tolist()} and the input {np.asarray(control).tolist()}",
            key="robots[].dynamics",
            remedy=f"return finite numbers for {listed(dynamics.state_names)}: divisions, roots "
            "and logarithms must be defined for all allowed states and inputs",
        )
    return after


def dynamics_defect_m(positions_m: Floats, start_m: Floats, step_length_m: float) -> float:
    """Return the largest violation of `start_m` or of `step_length_m` by a path, in metres."""
    lengths = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    jump = float(np.linalg.norm(positions_m[0] - start_m))
    # NumPy's maximum propagates NaN; Python's does not.
    return float(np.max(lengths - step_length_m, initial=jump))


def braked_motion(path_m: Floats, drive: Drive | None, step_s: float) -> TimedMotion:
    """Return the motion along a plan (N + 1, 2), followed by braking if there is a `drive`."""
    if drive is None:
        return TimedMotion(path_m)
    dynamics, last = drive.dynamics, drive.states[-1]
    braking = dynamics.braking(last, step_s, dynamics.stop_steps(last, step_s))
    stop = rolled_out(dynamics, last, braking, step_s)
    states = np.vstack([drive.states, stop.states[1:]])
    inputs = np.vstack([drive.inputs, stop.inputs])
    return TimedMotion(
        np.vstack([path_m, stop.positions_m[1:]]),
        tuple(dynamics.curves(states[:-1], inputs, step_s)),
    )


def stopping_motion(dynamics: Dynamics, state: Floats, step_s: float) -> TimedMotion:
    """Return the motion of a robot that brakes from `state` (s,) as soon as possible."""
    resting = Drive(dynamics, state[None], np.zeros((0, len(dynamics.input_names))))
    return braked_motion(state[None, :2], resting, step_s)
