"""Dynamics of robots: the interface that planners and the verifier use, and drives.

States and inputs are tuples of components, so that NumPy numbers, NumPy arrays (of any shape) and
CasADi expressions pass through the same formula. Inputs are constant over a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, listed
from planopt.parts import calling, class_name
from planopt.world.motion import Curve, StepCurve, TimedMotion

Components = tuple[Any, ...]
"""A number, array or expression for each component of a state or an input."""


@dataclass(frozen=True)
class Disc:
    """A limit of a pair of components to a disc: its square over that of the radius, less 1."""

    limit: int  # Its number among the limits
    names: tuple[str, str]  # Of the pair: components of the state after a step, or of the input
    radius: float  # Largest length of the pair


class Dynamics(Protocol):
    """The dynamics of a robot: how it moves, brakes and turns."""

    @property
    def kind(self) -> str:
        """Return the name in problem files."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the components of the state, with units; the first two are ``x_m`` and ``y_m``."""
        ...

    @property
    def input_names(self) -> tuple[str, ...]:
        """Return the components of the input, with units."""
        ...

    @property
    def speed_max_m_s(self) -> float:
        """Return the largest speed."""
        ...

    @property
    def discs(self) -> tuple[Disc, ...]:
        """Return the limits that are discs."""
        ...

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """Return the state after a step."""
        ...

    def limits(self, control: Components, after: Components) -> Components:
        """Return constraints, at most 0, on the input of a step and the state after it, scaled."""
        ...

    def control_points(
        self, state: Components, control: Components, step_s: float
    ) -> tuple[tuple[Any, Any], ...]:
        """Return points whose convex hull, with both ends, contains the path of a step."""
        ...

    def hull_pad_m(self, step_s: float) -> float:
        """Return the largest distance of the path of a step from that hull, in metres."""
        ...

    def timed_pad_m(self, step_s: float) -> float:
        """Return how much farther the path may be from the hull's points at equal times.

        The points are evenly spaced in time, as those of Bezier curves.
        """
        ...

    def stop_points(self, state: Components, step_s: float) -> tuple[tuple[Any, Any], ...]:
        """Return points whose hull, with the position, contains the braking path from a state."""
        ...

    def stop_curve(self, state: NDArray[np.float64], step_s: float) -> Curve | None:
        """Return the braking path from a state; None where it stops at once."""
        ...

    def stop_rows(self, state: Components, step_s: float) -> Components:
        """Return differences of the state that must be 0 so that the robot can stop; () if none."""
        ...

    def stop_steps(self, state: NDArray[np.float64], step_s: float) -> int:
        """Return the number of steps of :meth:`braking` until it stands."""
        ...

    def longest_stop_steps(self, step_s: float) -> int:
        """Return the largest such number from any state within the limits."""
        ...

    def resting_place(self, state: Components) -> tuple[Any, Any]:
        """Return about where braking from a state ends; smooth in the state."""
        ...

    def turning_s(self, state: Components, place: tuple[Any, Any]) -> Any:
        """Return about how long it turns before driving to a position; smooth, 0 there."""
        ...

    def braking(self, state: NDArray[np.float64], step_s: float, steps: int) -> NDArray[np.float64]:
        """Return inputs (steps, m) that stop as soon as possible and then rest."""
        ...

    def following(
        self, state: NDArray[np.float64], path_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Return inputs (N, m) that approximately follow a path (N, 2) of straight steps."""
        ...

    def straight(
        self, state: NDArray[np.float64], end_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64] | None:
        """Return inputs (k, m) of a straight drive from rest to rest at `end_m`; None if unknown.

        Braking after any of them ends on the line, short of `end_m`.
        """
        ...

    def may_reach(
        self,
        state: NDArray[np.float64],
        places_m: NDArray[np.float64],
        duration_s: float,
        slack_m: float,
    ) -> NDArray[np.bool_]:
        """Return whether it may be within `slack_m` of places (n, 2) after a duration.

        Obstacles and the largest speed are left out; never False where the robot can be.
        """
        ...

    def curves(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> list[StepCurve]:
        """Return the paths of steps from states (n, s) with inputs (n, m)."""
        ...

    def excess_m(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> float:
        """Return the excess of inputs or speeds over their limits, in metres a step."""
        ...

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """Return the metres that a unit of each component of the state makes in about a step."""
        ...


class BaseDynamics:
    """Defaults of dynamics: limits are intervals, hulls are exact, and the robot stops at once."""

    @property
    def discs(self) -> tuple[Disc, ...]:
        """Return no disc."""
        return ()

    def hull_pad_m(self, step_s: float) -> float:
        """Return 0."""
        return 0.0

    def timed_pad_m(self, step_s: float) -> float:
        """Return 0."""
        return 0.0

    def stop_points(self, state: Components, step_s: float) -> tuple[tuple[Any, Any], ...]:
        """Return no points."""
        return ()

    def stop_curve(self, state: NDArray[np.float64], step_s: float) -> Curve | None:
        """Return None."""
        return None

    def stop_rows(self, state: Components, step_s: float) -> Components:
        """Return no rows: it can stop from any state."""
        return ()

    def stop_steps(self, state: NDArray[np.float64], step_s: float) -> int:
        """Return 0."""
        return 0

    def longest_stop_steps(self, step_s: float) -> int:
        """Return 0."""
        return 0

    def resting_place(self, state: Components) -> tuple[Any, Any]:
        """Return its place."""
        return state[0], state[1]

    def turning_s(self, state: Components, place: tuple[Any, Any]) -> Any:
        """Return 0: it drives to any side, or nothing is known of how it turns."""
        return 0.0

    def braking(self, state: NDArray[np.float64], step_s: float, steps: int) -> NDArray[np.float64]:
        """Return two inputs of 0 for each step."""
        return np.zeros((steps, 2))

    def may_reach(
        self,
        state: NDArray[np.float64],
        places_m: NDArray[np.float64],
        duration_s: float,
        slack_m: float,
    ) -> NDArray[np.bool_]:
        """Return True for every place: only the largest speed bounds where it may be."""
        return np.ones(len(places_m), dtype=np.bool_)


@runtime_checkable
class RestsByInput(Protocol):
    """Dynamics with bounds of the input, and the input with which the robot rests."""

    rest_input: tuple[float, ...]
    input_bounds: tuple[tuple[float, float], ...]

    def change_at_rest(self, state: NDArray[np.float64], step_s: float) -> NDArray[np.float64]:
        """Return the least change ``(s,)`` of a state at this position by the rest input."""
        ...


class PurePursuit:
    """The point ahead on a path that a robot heads for, without turning back."""

    def __init__(self, path_m: NDArray[np.float64]) -> None:
        lengths = np.linalg.norm(np.diff(path_m, axis=0), axis=1)
        self._path_m = path_m
        self._along_m = np.concatenate([[0.0], np.cumsum(lengths)])
        self._at_m = 0.0
        legs = np.diff(path_m, axis=0)[lengths > 0.0]
        along = legs / np.linalg.norm(legs, axis=1)[:, None]
        # Twice the sine of half of each turn: how much the direction changes.
        self._turn = np.linalg.norm(np.diff(along, axis=0), axis=1)
        self._corner_m = np.cumsum(lengths[lengths > 0.0])

    def ahead_m(
        self, place_m: NDArray[np.float64], lookahead_m: float
    ) -> tuple[NDArray[np.float64], float]:
        """Return the point (2,) to head for from `place_m` (2,), and the rest of the path."""
        along = np.linspace(self._at_m, self._at_m + 1.5 * lookahead_m, 33)
        away = np.linalg.norm(self._points(along) - place_m, axis=1)
        self._at_m = float(min(along[int(away.argmin())], self._along_m[-1]))
        target = self._points(np.array([self._at_m + lookahead_m]))[0]
        return target, float(self._along_m[-1] - self._at_m)

    def speed_m_s(self, acceleration_m_s2: float, swing_m: float) -> float:
        """Return the speed that lets a robot take the turns and stop at the end."""
        turn = np.append(self._turn, np.inf)[-len(self._corner_m) :]
        # To change its direction it takes turn v / a seconds, in which it drives twice the swing.
        square = 2.0 * acceleration_m_s2 * swing_m / np.maximum(turn, 1e-9)
        left = self._corner_m - self._at_m
        square = square + 2.0 * acceleration_m_s2 * np.maximum(left, 0.0)
        ahead = left > -1e-9
        return float(np.sqrt(square[ahead].min())) if ahead.any() else 0.0

    def _points(self, along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack(
            [np.interp(along_m, self._along_m, self._path_m[:, axis]) for axis in (0, 1)]
        )


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
    dynamics, last = drive.dynamics, drive.states[-1]
    braking = dynamics.braking(last, step_s, dynamics.stop_steps(last, step_s))
    stop = rolled_out(dynamics, last, braking, step_s)
    states = np.vstack([drive.states, stop.states[1:]])
    inputs = np.vstack([drive.inputs, stop.inputs])
    return TimedMotion(
        np.vstack([path_m, stop.positions_m[1:]]),
        tuple(dynamics.curves(states[:-1], inputs, step_s)),
    )


def stopping_motion(dynamics: Dynamics, state: NDArray[np.float64], step_s: float) -> TimedMotion:
    """Return the motion of a robot that stops from `state` (s,) as soon as it can."""
    resting = Drive(dynamics, state[None], np.zeros((0, len(dynamics.input_names))))
    return braked_motion(state[None, :2], resting, step_s)
