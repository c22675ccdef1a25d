"""The interface of a robot's dynamics that planners and the verifier use.

States and inputs are tuples of components, so that NumPy numbers, NumPy arrays (of any shape) and
CasADi expressions pass through the same formula. Inputs are constant over a step.
The single integrator needs none of this: its steps are the differences of its positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from planopt.world.ways import StepWay, Way

Components = tuple[Any, ...]
"""One number, array or expression for each component of a state or an input."""


@dataclass(frozen=True)
class Disc:
    """A limit that a pair of components lies in a disc: squares over the radius's, less 1."""

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
        """Names with units; the first two are ``x_m`` and ``y_m``."""
        ...

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names with units."""
        ...

    @property
    def speed_max_m_s(self) -> float:
        """It is never faster."""
        ...

    @property
    def discs(self) -> tuple[Disc, ...]:
        """Return the limits that are discs."""
        ...

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """The state after a step."""
        ...

    def limits(self, control: Components, after: Components) -> Components:
        """Return what must be at most 0, for a solver: input of a step, state after it, scaled."""
        ...

    def control_points(
        self, state: Components, control: Components, step_s: float
    ) -> tuple[tuple[Any, Any], ...]:
        """Points that with both ends have the whole way of a step in their convex hull."""
        ...

    def way_pad_m(self, step_s: float) -> float:
        """Return how far outside that hull the way of a step may be, in metres."""
        ...

    def timed_pad_m(self, step_s: float) -> float:
        """Return how much farther the way may be from the hull's points at equal times.

        The points are as far apart in time as they are in number, as those of Bezier curves are.
        """
        ...

    def stop_points(self, state: Components, step_s: float) -> tuple[tuple[Any, Any], ...]:
        """Points that with the place have the way of stopping from a state in their hull."""
        ...

    def stop_way(self, state: NDArray[np.float64], step_s: float) -> Way | None:
        """The way of stopping from a state; None where it stands at once."""
        ...

    def stop_rows(self, state: Components, step_s: float) -> Components:
        """Return what must be 0 so that the robot can stop from a state; none where it always can.

        Differences of the components of the state.
        """
        ...

    def stop_steps(self, state: NDArray[np.float64], step_s: float) -> int:
        """Return how many steps of :meth:`braking` it takes to stop."""
        ...

    def longest_stop_steps(self, step_s: float) -> int:
        """The most that it takes from any state within the limits."""
        ...

    def resting_place(self, state: Components) -> tuple[Any, Any]:
        """Return about where it comes to stand if it brakes from a state; smooth in the state."""
        ...

    def turning_s(self, state: Components, place: tuple[Any, Any]) -> Any:
        """Return about how long it turns before driving to a place; smooth, 0 at the place."""
        ...

    def braking(self, state: NDArray[np.float64], step_s: float, steps: int) -> NDArray[np.float64]:
        """Inputs (steps, m) that stop as soon as they can and then rest."""
        ...

    def following(
        self, state: NDArray[np.float64], path_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Inputs (N, m) that lead about along a path (N, 2) of straight steps."""
        ...

    def straight(
        self, state: NDArray[np.float64], end_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64] | None:
        """Inputs (k, m) from rest to rest at a place (2,), straight there; None if none are known.

        Braking after any of them ends short of the place, on the way to it.
        """
        ...

    def may_reach(
        self,
        state: NDArray[np.float64],
        places_m: NDArray[np.float64],
        duration_s: float,
        slack_m: float,
    ) -> NDArray[np.bool_]:
        """Return whether it may be at places (n, 2) after a while, or `slack_m` from there.

        Obstacles and the largest speed are left out; it is never False where the robot can be.
        """
        ...

    def ways(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> list[StepWay]:
        """The ways of steps from states (n, s) with inputs (n, m)."""
        ...

    def excess_m(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> float:
        """Return the excess of inputs or speeds over their limits, in metres a step."""
        ...

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """Return how many metres a unit of each component of the state makes, in about a step."""
        ...


@runtime_checkable
class RestsByInput(Protocol):
    """Dynamics that tell what their inputs may be, and with which the robot rests."""

    rest_input: tuple[float, ...]
    input_bounds: tuple[tuple[float, float], ...]

    def change_at_rest(self, state: NDArray[np.float64], step_s: float) -> NDArray[np.float64]:
        """Return how the rest input changes the state ``(s,)`` of this place that it changes least.

        ``(s,)``, in the units of the state; zeros where the robot can rest.
        """
        ...


class PurePursuit:
    """Follows a robot along a path without turning back."""

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
        """The point (2,) to head for from `place_m` (2,), and how much of the path is left."""
        tried = np.linspace(self._at_m, self._at_m + 1.5 * lookahead_m, 33)
        away = np.linalg.norm(self._points(tried) - place_m, axis=1)
        self._at_m = float(min(tried[int(away.argmin())], self._along_m[-1]))
        target = self._points(np.array([self._at_m + lookahead_m]))[0]
        return target, float(self._along_m[-1] - self._at_m)

    def speed_m_s(self, acceleration_m_s2: float, swing_m: float) -> float:
        """Return the speed from which a robot can stop at the end without swinging out."""
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
