"""The double integrator: acceleration in a disc, speed in a disc, zero-order hold exactly.

p+ = p + h v + h^2/2 a and v+ = v + h a with |a| <= a_max, |v| <= v_max. Speed is convex along a
step, so that both ends keep the limit for all of it. The way of a step is a parabola, a Bezier
curve with the middle point p + h/2 v.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.robots.dynamics import Components, Disc, PurePursuit
from planopt.world.ways import Parabola, PointWay, StepWay

STOPPED_M_S = 1e-9
"""A speed up to this is standing still."""

BRAKING_SHARE = 0.8
"""Share of the acceleration that followed paths are slowed down with for turns and their end."""

ROUNDED_SHARE = 1e-3
"""Speeds below this share of the largest count as about so much where a resting place is meant."""

SWING_SHARE = 0.25
"""How far a followed path may be swung out of at turns, as a share of the longest step."""


@dataclass(frozen=True)
class DoubleIntegrator:
    """A robot with inertia.

    Attributes
    ----------
    speed_max_m_s, acceleration_max_m_s2
        Largest speed and acceleration.
    """

    speed_max_m_s: float
    acceleration_max_m_s2: float

    @property
    def kind(self) -> str:
        """Return the name in problem files."""
        return "double_integrator"

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names with units."""
        return ("x_m", "y_m", "velocity_x_m_s", "velocity_y_m_s")

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names with units."""
        return ("acceleration_x_m_s2", "acceleration_y_m_s2")

    @property
    def discs(self) -> tuple[Disc, ...]:
        """Return the discs of both limits."""
        return (
            Disc(0, ("acceleration_x_m_s2", "acceleration_y_m_s2"), self.acceleration_max_m_s2),
            Disc(1, ("velocity_x_m_s", "velocity_y_m_s"), self.speed_max_m_s),
        )

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """The state after a step of constant acceleration, exact."""
        (x, y, vx, vy), (ax, ay) = state, control
        half = 0.5 * step_s * step_s
        return (
            x + step_s * vx + half * ax,
            y + step_s * vy + half * ay,
            vx + step_s * ax,
            vy + step_s * ay,
        )

    def limits(self, control: Components, after: Components) -> Components:
        """Squares of acceleration and speed over the largest, less 1."""
        (ax, ay), (_, _, vx, vy) = control, after
        return (
            (ax * ax + ay * ay) / self.acceleration_max_m_s2**2 - 1.0,
            (vx * vx + vy * vy) / self.speed_max_m_s**2 - 1.0,
        )

    def control_points(
        self, state: Components, control: Components, step_s: float
    ) -> tuple[tuple[Any, Any], ...]:
        """The middle Bezier point."""
        x, y, vx, vy = state
        return ((x + 0.5 * step_s * vx, y + 0.5 * step_s * vy),)

    def way_pad_m(self, step_s: float) -> float:
        """Return 0: the hull is exact."""
        return 0.0

    def timed_pad_m(self, step_s: float) -> float:
        """Return 0: the middle Bezier point belongs to the middle of the step."""
        return 0.0

    def stop_points(self, state: Components, step_s: float) -> tuple[tuple[Any, Any], ...]:
        """A point on the straight way ahead, at or beyond where braking by whole steps ends.

        n steps of deceleration v / (n h) <= a_max take v n h / 2 <= v (v / a_max + h) / 2 metres.
        """
        x, y, vx, vy = state
        # The square root of v^2 has no derivative at rest: v <= (v^2 / v_max + v_max) / 2 is above.
        square = (vx * vx + vy * vy) / self.speed_max_m_s**2
        speed = 0.5 * self.speed_max_m_s * (1.0 + square)
        ahead_s = 0.5 * (speed / self.acceleration_max_m_s2 + step_s)
        return ((x + ahead_s * vx, y + ahead_s * vy),)

    def stop_way(self, state: NDArray[np.float64], step_s: float) -> PointWay:
        """Straight ahead, as far as braking by whole steps goes."""
        stop_s = 0.5 * step_s * self.stop_steps(state, step_s)
        return PointWay(np.array([state[:2], state[:2] + stop_s * state[2:]]), 0.0)

    def stop_rows(self, state: Components, step_s: float) -> Components:
        """Return none: it can always brake."""
        return ()

    def stop_steps(self, state: NDArray[np.float64], step_s: float) -> int:
        """Least number of steps to stop in."""
        return self._steps_from(float(np.hypot(state[2], state[3])), step_s)

    def longest_stop_steps(self, step_s: float) -> int:
        """Return the steps of braking from full speed."""
        return self._steps_from(self.speed_max_m_s, step_s)

    def _steps_from(self, speed_m_s: float, step_s: float) -> int:
        if speed_m_s <= STOPPED_M_S:
            return 0
        # Round-off must not make it a step more than the last plan had left.
        return max(1, math.ceil(speed_m_s / (self.acceleration_max_m_s2 * step_s) - 1e-6))

    def resting_place(self, state: Components) -> tuple[Any, Any]:
        """v^2 / (2 a_max) ahead; v is rounded, so that its derivative exists at rest."""
        x, y, vx, vy = state
        least = ROUNDED_SHARE * self.speed_max_m_s
        ahead_s = 0.5 * (vx * vx + vy * vy + least**2) ** 0.5 / self.acceleration_max_m_s2
        return x + ahead_s * vx, y + ahead_s * vy

    def turning_s(self, state: Components, place: tuple[Any, Any]) -> Any:
        """Return 0: it accelerates to any side."""
        return 0.0

    def braking(self, state: NDArray[np.float64], step_s: float, steps: int) -> NDArray[np.float64]:
        """Even deceleration over as few steps as it takes, straight ahead."""
        inputs = np.zeros((steps, 2))
        takes = self.stop_steps(state, step_s)
        if takes:
            inputs[:takes] = -state[2:] / (takes * step_s)
        return inputs

    def following(
        self, state: NDArray[np.float64], path_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Head for a point a little ahead on the path; slow down for turns and for its end."""
        pursuit = PurePursuit(np.vstack([state[:2], path_m]))
        here = tuple(state)
        inputs = np.zeros((len(path_m), 2))
        for k in range(len(path_m)):
            place, velocity = np.array(here[:2]), np.array(here[2:])
            target, left_m = pursuit.ahead_m(place, self.speed_max_m_s * step_s)
            offset = target - place
            length = float(np.hypot(*offset))
            lookahead = self.speed_max_m_s * step_s
            slowed = BRAKING_SHARE * self.acceleration_max_m_s2
            speed = min(
                self.speed_max_m_s,
                pursuit.speed_m_s(slowed, SWING_SHARE * lookahead),
                left_m / step_s,
            )
            wanted = offset * (speed / length) if length > 0.0 else np.zeros(2)
            control = (wanted - velocity) / step_s
            over = float(np.hypot(*control)) / self.acceleration_max_m_s2
            inputs[k] = control / max(over, 1.0)
            here = self.step(here, tuple(inputs[k]), step_s)
        return inputs

    def straight(
        self, state: NDArray[np.float64], end_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Accelerate evenly for n steps, decelerate evenly for as many: a (n h)^2 metres."""
        offset = end_m - state[:2]
        length = float(np.hypot(*offset))
        by_speed = length / (self.speed_max_m_s * step_s)
        by_acceleration = math.sqrt(length / self.acceleration_max_m_s2) / step_s
        half = max(1, math.ceil(max(by_speed, by_acceleration) - 1e-9))
        control = offset / (half * step_s) ** 2
        return np.repeat([control, -control], half, axis=0)

    def may_reach(
        self,
        state: NDArray[np.float64],
        places_m: NDArray[np.float64],
        duration_s: float,
        slack_m: float,
    ) -> NDArray[np.bool_]:
        """The disc of radius a t^2 / 2 about where it would coast to."""
        away = places_m - (state[:2] + duration_s * state[2:])
        radius = 0.5 * self.acceleration_max_m_s2 * duration_s**2
        return np.hypot(away[:, 0], away[:, 1]) <= radius + slack_m

    def ways(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> list[StepWay]:
        """The parabola of each step."""
        half = 0.5 * step_s * step_s
        return [
            Parabola(state[:2], step_s * state[2:], half * control)
            for state, control in zip(states, inputs, strict=True)
        ]

    def excess_m(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> float:
        """Return the excess of acceleration and speed, in metres a step; NaN where one is NaN."""
        acceleration = np.hypot(inputs[:, 0], inputs[:, 1]) - self.acceleration_max_m_s2
        speed = np.hypot(states[:, 2], states[:, 3]) - self.speed_max_m_s
        return float(np.max(np.concatenate([0.5 * step_s * step_s * acceleration, step_s * speed])))

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """A speed makes what it drives in a step."""
        return (1.0, 1.0, step_s, step_s)
