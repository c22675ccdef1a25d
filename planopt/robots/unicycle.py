"""The unicycle: forward speed and turn rate as inputs, constant over a step.

x' = v cos(heading), y' = v sin(heading), heading' = w. The way of a step is straight or a circular
arc, exactly: with the half turn z = w h / 2 its chord is v h sin(z)/z long, in the direction
heading + z. It lies in the triangle of its ends and the point where the tangents at them meet,
v h tan(z) / (2 z) ahead; a step that may turn far is cut into arcs of which each turns little.

Sine, cosine and sin(z)/z of NumPy arrays and of CasADi expressions alike.

No branches: what stands here has derivatives everywhere, at zero too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.robots.dynamics import Components, Disc, PurePursuit
from planopt.world.ways import Arc, StepWay

HALVINGS = 3
"""sin(z)/z is a product of cosines down to z / 8, and a series from there."""


def sine(angle: Any) -> Any:
    """Sine of an angle in rad."""
    return angle.sin() if hasattr(angle, "sin") else np.sin(angle)


def cosine(angle: Any) -> Any:
    """Cosine of an angle in rad."""
    return angle.cos() if hasattr(angle, "cos") else np.cos(angle)


def sinc(angle: Any) -> Any:
    """sin(z) / z, 1 at zero, to round-off for angles of up to about 3 rad.

    From sin(z) = 2 sin(z/2) cos(z/2), applied three times, and the series of the rest.
    """
    rest = angle / 2.0**HALVINGS
    square = rest * rest
    series = 1.0 - square / 6.0 * (
        1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0 * (1.0 - square / 110.0)))
    )
    for halving in range(1, HALVINGS + 1):
        series = series * cosine(angle / 2.0**halving)
    return series


PIECE_TURN_RAD = math.pi / 4.0
"""A step is cut into arcs that turn no more than this: its hull is then near to the arc."""

ROUNDED_SHARE = 1e-3
"""Rounding of the distance to a place that is turned to, as a share of the turning circle."""


@dataclass(frozen=True)
class Unicycle:
    """A robot that drives where it faces, such as one with two driven wheels.

    Attributes
    ----------
    speed_max_m_s, speed_min_m_s
        Largest and least forward speed; a negative one is backward. The least is at most 0, so that
        the robot can stop.
    turn_rate_max_rad_s
        Largest turn rate, to either side.
    """

    speed_max_m_s: float
    turn_rate_max_rad_s: float
    speed_min_m_s: float = 0.0

    @property
    def kind(self) -> str:
        """Return the name in problem files."""
        return "unicycle"

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names with units."""
        return ("x_m", "y_m", "heading_rad")

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names with units."""
        return ("speed_m_s", "turn_rate_rad_s")

    @property
    def discs(self) -> tuple[Disc, ...]:
        """Return no disc: all limits are intervals."""
        return ()

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """The state after a step, exact."""
        (x, y, heading), (speed, rate) = state, control
        half = 0.5 * step_s * rate
        chord = step_s * speed * sinc(half)
        return (
            x + chord * cosine(heading + half),
            y + chord * sine(heading + half),
            heading + step_s * rate,
        )

    def limits(self, control: Components, after: Components) -> Components:
        """Return both inputs over their intervals, scaled."""
        speed, rate = control
        return (
            (speed - self.speed_max_m_s) / self.speed_max_m_s,
            (self.speed_min_m_s - speed) / self.speed_max_m_s,
            (rate - self.turn_rate_max_rad_s) / self.turn_rate_max_rad_s,
            (-rate - self.turn_rate_max_rad_s) / self.turn_rate_max_rad_s,
        )

    def control_points(
        self, state: Components, control: Components, step_s: float
    ) -> tuple[tuple[Any, Any], ...]:
        """Return where tangents of each piece of the arc meet, and where pieces meet."""
        pieces = self._pieces(step_s)
        piece_s = step_s / pieces
        speed, rate = control
        half = 0.5 * piece_s * rate
        ahead = 0.5 * piece_s * speed * sinc(half) / cosine(half)
        points: list[tuple[Any, Any]] = []
        for piece in range(pieces):
            x, y, heading = state
            points.append((x + ahead * cosine(heading), y + ahead * sine(heading)))
            state = self.step(state, control, piece_s)
            if piece + 1 < pieces:
                points.append((state[0], state[1]))
        return tuple(points)

    def _pieces(self, step_s: float) -> int:
        return max(1, math.ceil(self.turn_rate_max_rad_s * step_s / PIECE_TURN_RAD))

    def way_pad_m(self, step_s: float) -> float:
        """Return 0: the hull is exact."""
        return 0.0

    def timed_pad_m(self, step_s: float) -> float:
        """Return the distance of a piece from its hull's Bezier curve at the same time.

        With r the radius, z half the turn and time u from -1 to 1, the arc is at ``r sin(u z)``
        along the chord and ``r (cos(u z) - cos z)`` across, the curve at ``r u sin(z)`` and
        ``r (1 - u^2) sin^2(z) / (2 cos z)``. Along, they are farthest apart where
        ``cos(u z) = sin(z) / z``; across, at u = 0; both the more the faster it drives and turns.
        """
        half = 0.5 * self.turn_rate_max_rad_s * step_s / self._pieces(step_s)
        speed = max(self.speed_max_m_s, -self.speed_min_m_s)
        farthest = math.acos(math.sin(half) / half)
        along = math.sin(farthest) - farthest / half * math.sin(half)
        across = 0.5 * math.sin(half) * math.tan(half) - (1.0 - math.cos(half))
        return speed / self.turn_rate_max_rad_s * math.hypot(along, across)

    def stop_points(self, state: Components, step_s: float) -> tuple[tuple[Any, Any], ...]:
        """Return none: it stops at once."""
        return ()

    def stop_way(self, state: NDArray[np.float64], step_s: float) -> None:
        """Return None: it stops at once."""

    def stop_rows(self, state: Components, step_s: float) -> Components:
        """Return none: it stops at once."""
        return ()

    def stop_steps(self, state: NDArray[np.float64], step_s: float) -> int:
        """Return 0: it stops at once."""
        return 0

    def longest_stop_steps(self, step_s: float) -> int:
        """Return 0: it stops at once."""
        return 0

    def resting_place(self, state: Components) -> tuple[Any, Any]:
        """Return its place."""
        return state[0], state[1]

    def turning_s(self, state: Components, place: tuple[Any, Any]) -> Any:
        """Return pi / (2 w_max) (1 - cos b) d / (d + r), of bearing b and distance d.

        That is what a half turn takes, and less within the turning circle, r = v_max / w_max.
        """
        x, y = place[0] - state[0], place[1] - state[1]
        circle_m = self.speed_max_m_s / self.turn_rate_max_rad_s
        away = (x * x + y * y + (ROUNDED_SHARE * circle_m) ** 2) ** 0.5
        ahead = x * cosine(state[2]) + y * sine(state[2])
        return 0.5 * math.pi / self.turn_rate_max_rad_s * (away - ahead) / (away + circle_m)

    def braking(self, state: NDArray[np.float64], step_s: float, steps: int) -> NDArray[np.float64]:
        """Nothing moves."""
        return np.zeros((steps, 2))

    def following(
        self, state: NDArray[np.float64], path_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Drive on the arc to a point a little ahead on the path; turn first if it is behind."""
        pursuit = PurePursuit(np.vstack([state[:2], path_m]))
        here = tuple(state)
        inputs = np.zeros((len(path_m), 2))
        for k in range(len(path_m)):
            place = np.array(here[:2])
            target, left_m = pursuit.ahead_m(place, self.speed_max_m_s * step_s)
            inputs[k] = self._towards(target - place, float(here[2]), left_m, step_s)
            here = self.step(here, tuple(inputs[k]), step_s)
        return inputs

    def _towards(
        self, offset_m: NDArray[np.float64], heading: float, left_m: float, step_s: float
    ) -> tuple[float, float]:
        """Inputs towards a point: the arc that is tangent to the heading and goes through it."""
        distance = float(np.hypot(*offset_m))
        if distance <= 1e-9 or left_m <= 0.0:
            return 0.0, 0.0
        bearing = math.atan2(offset_m[1], offset_m[0]) - heading
        bearing = math.remainder(bearing, 2.0 * math.pi)
        if abs(bearing) > math.pi / 3.0:
            limit = self.turn_rate_max_rad_s
            return 0.0, min(max(bearing / step_s, -limit), limit)
        curvature = 2.0 * math.sin(bearing) / distance
        speed = min(self.speed_max_m_s, left_m / step_s)
        if abs(curvature) * speed > self.turn_rate_max_rad_s:
            speed = self.turn_rate_max_rad_s / abs(curvature)
        return speed, speed * curvature

    def straight(
        self, state: NDArray[np.float64], end_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Turn where it stands, then drive ahead."""
        offset = end_m - state[:2]
        away = math.atan2(offset[1], offset[0]) - float(state[2])
        angle = math.remainder(away, 2.0 * math.pi)
        turns = math.ceil(abs(angle) / (self.turn_rate_max_rad_s * step_s) - 1e-9)
        length = float(np.hypot(*offset))
        ahead = max(1, math.ceil(length / (self.speed_max_m_s * step_s) - 1e-9))
        inputs = np.zeros((turns + ahead, 2))
        inputs[:turns, 1] = angle / (max(turns, 1) * step_s)
        inputs[turns:, 0] = length / (ahead * step_s)
        return inputs

    def may_reach(
        self,
        state: NDArray[np.float64],
        places_m: NDArray[np.float64],
        duration_s: float,
        slack_m: float,
    ) -> NDArray[np.bool_]:
        """No farther to the side than turning allows: v (1 - cos w t) / w up to a quarter turn.

        Until then nothing behind it, if it cannot drive backward.
        """
        rate = self.turn_rate_max_rad_s
        turning_s = min(duration_s, 0.5 * math.pi / rate)
        speed = max(self.speed_max_m_s, -self.speed_min_m_s)
        sideways = speed * ((1.0 - math.cos(rate * turning_s)) / rate + duration_s - turning_s)
        ahead = np.array([math.cos(state[2]), math.sin(state[2])])
        offset = places_m - state[:2]
        across = np.abs(offset @ np.array([-ahead[1], ahead[0]]))
        reached = across <= sideways + slack_m
        if self.speed_min_m_s == 0.0 and turning_s == duration_s:
            reached &= offset @ ahead >= -slack_m
        return reached

    def ways(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> list[StepWay]:
        """The arc of each step."""
        return [
            Arc(state[:2], float(state[2]), step_s * float(speed), step_s * float(rate))
            for state, (speed, rate) in zip(states, inputs, strict=True)
        ]

    def excess_m(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> float:
        """Return the excess of speed and of turn rate, in metres a step; NaN where one is NaN."""
        speed = np.maximum(inputs[:, 0] - self.speed_max_m_s, self.speed_min_m_s - inputs[:, 0])
        rate = np.abs(inputs[:, 1]) - self.turn_rate_max_rad_s
        sideways = 0.5 * step_s * step_s * self.speed_max_m_s * rate
        return float(np.max(np.concatenate([step_s * speed, sideways])))

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """A heading makes what full speed is off by after a step."""
        return (1.0, 1.0, self.speed_max_m_s * step_s)
