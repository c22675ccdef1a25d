"""Built-in dynamics of problem files: single integrator, double integrator and unicycle.

The formulas have no branches, so they are differentiable everywhere, including zero.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.robots.dynamics import Components, Disc, Dynamics, PurePursuit
from planopt.world.motion import Arc, Parabola, PointCurve, StepCurve

STOPPED_M_S = 1e-9  # Speed in m/s up to which a robot counts as stationary
BRAKING_SHARE = 0.8
"""Share of the maximum acceleration that slows a robot down for turns and the end of a path."""
ROUNDED_SHARE = 1e-3  # Smoothing width relative to the largest speed, and to the turning radius
SWING_SHARE = 0.25  # Maximum tracking error at the turns of a path, as a share of the longest step
PIECE_TURN_RAD = math.pi / 4.0
"""Maximum turn per arc; steps are divided into arcs with narrow convex hulls."""
DIRECTIONS = 17  # Number of directions in which the range of a unicycle is tested
HALVINGS = 3  # Number of halvings of z in sin(z)/z, down to z / 8, at which the series is evaluated


@dataclass(frozen=True)
class SingleIntegrator(Dynamics):
    """Holonomic robot whose velocity is the input.

    q+ = q + h v with norm(v) <= v_max. The state is the position.

    Attributes
    ----------
    speed_max_m_s
        Largest speed; a :class:`planopt.Robot` sets its own.
    """

    speed_max_m_s: float = math.inf

    kind = "single_integrator"
    state_names = ("x_m", "y_m")
    input_names = ("velocity_x_m_s", "velocity_y_m_s")

    @property
    def discs(self) -> tuple[Disc, ...]:
        """Return the disc constraint on the velocity."""
        return (Disc(0, self.input_names, self.speed_max_m_s),)

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """Return the exact state after a step."""
        return tuple(x + step_s * v for x, v in zip(state, control, strict=True))

    def limits(self, control: Components, after: Components) -> Components:
        """Return the limit of the speed as (|v| / v_max)^2 - 1, which must be <= 0."""
        return ((control[0] ** 2 + control[1] ** 2) / self.speed_max_m_s**2 - 1.0,)

    def control_points(
        self, state: Components, control: Components, step_s: float
    ) -> tuple[tuple[Any, Any], ...]:
        """Return no points, as the two ends span the straight step."""
        return ()

    def following(self, state: Floats, path_m: Floats, step_s: float) -> Floats:
        """Return the velocities that follow the path exactly."""
        return np.diff(np.vstack([state, path_m]), axis=0) / step_s

    def straight(self, state: Floats, end_m: Floats, step_s: float) -> Floats:
        """Return constant velocities of a straight drive to `end_m`."""
        offset = end_m - state
        steps = max(1, math.ceil(math.hypot(*offset) / (self.speed_max_m_s * step_s) - 1e-9))
        return np.tile(offset / (steps * step_s), (steps, 1))

    def curves(self, states: Floats, inputs: Floats, step_s: float) -> list[StepCurve]:
        """Return each step's path as a line segment."""
        ends = states + step_s * inputs
        return [PointCurve(np.array(pair), 0.0) for pair in zip(states, ends, strict=True)]

    def excess_m(self, states: Floats, inputs: Floats, step_s: float) -> float:
        """Return the largest excess over the speed limit, in metres per step; NaN if undefined."""
        return float(np.max(step_s * (np.hypot(*inputs.T) - self.speed_max_m_s), initial=-np.inf))

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """Return the displacement in metres per unit of each state component: 1 for positions."""
        return (1.0, 1.0)


@dataclass(frozen=True)
class DoubleIntegrator(Dynamics):
    """Robot with inertia whose acceleration is the input.

    p+ = p + h v + h^2/2 a and v+ = v + h a with norm(a) <= a_max and norm(v) <= v_max. Speed is
    convex over a step, so the limit holds throughout if it holds at both ends. A step is a
    parabola, i.e. a Bezier curve with the middle control point p + h/2 v.

    Attributes
    ----------
    speed_max_m_s, acceleration_max_m_s2
        Largest speed and acceleration.
    """

    speed_max_m_s: float
    acceleration_max_m_s2: float

    kind = "double_integrator"
    state_names = ("x_m", "y_m", "velocity_x_m_s", "velocity_y_m_s")
    input_names = ("acceleration_x_m_s2", "acceleration_y_m_s2")

    @property
    def discs(self) -> tuple[Disc, ...]:
        """Return the disc constraints on acceleration and velocity."""
        return (
            Disc(0, self.input_names, self.acceleration_max_m_s2),
            Disc(1, self.state_names[2:], self.speed_max_m_s),
        )

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """Return the exact state after a step of constant acceleration."""
        (x, y, vx, vy), (ax, ay) = state, control
        half = 0.5 * step_s * step_s
        return (
            x + step_s * vx + half * ax,
            y + step_s * vy + half * ay,
            vx + step_s * ax,
            vy + step_s * ay,
        )

    def limits(self, control: Components, after: Components) -> Components:
        """Return the limits of acceleration and speed as squared ratios minus 1, to be <= 0."""
        (ax, ay), (_, _, vx, vy) = control, after
        return (
            (ax * ax + ay * ay) / self.acceleration_max_m_s2**2 - 1.0,
            (vx * vx + vy * vy) / self.speed_max_m_s**2 - 1.0,
        )

    def control_points(
        self, state: Components, control: Components, step_s: float
    ) -> tuple[tuple[Any, Any], ...]:
        """Return the middle Bezier control point of the step's parabola."""
        x, y, vx, vy = state
        return ((x + 0.5 * step_s * vx, y + 0.5 * step_s * vy),)

    def stop_points(self, state: Components, step_s: float) -> tuple[tuple[Any, Any], ...]:
        """Return a point straight ahead, at or beyond the position of rest after braking."""
        # n steps of deceleration v / (n h) <= a_max take at most v (v / a_max + h) / 2 metres.
        x, y, vx, vy = state
        # |v| is not differentiable at rest; (v^2 / v_max + v_max) / 2 is an upper bound.
        square = (vx * vx + vy * vy) / self.speed_max_m_s**2
        speed = 0.5 * self.speed_max_m_s * (1.0 + square)
        ahead_s = 0.5 * (speed / self.acceleration_max_m_s2 + step_s)
        return ((x + ahead_s * vx, y + ahead_s * vy),)

    def stop_curve(self, state: Floats, step_s: float) -> PointCurve:
        """Return the straight braking path over a whole number of steps."""
        stop_s = 0.5 * step_s * self.stop_steps(state, step_s)
        return PointCurve(np.array([state[:2], state[:2] + stop_s * state[2:]]), 0.0)

    def stop_steps(self, state: Floats, step_s: float) -> int:
        """Return the minimum number of steps in which the robot can stop."""
        return self._braking_steps(float(np.hypot(state[2], state[3])), step_s)

    def longest_stop_steps(self, step_s: float) -> int:
        """Return the number of braking steps from full speed."""
        return self._braking_steps(self.speed_max_m_s, step_s)

    def _braking_steps(self, speed_m_s: float, step_s: float) -> int:
        if speed_m_s <= STOPPED_M_S:
            return 0
        # The tolerance keeps rounding errors from adding a step to the last plan.
        return max(1, math.ceil(speed_m_s / (self.acceleration_max_m_s2 * step_s) - 1e-6))

    def resting_place(self, state: Components) -> tuple[Any, Any]:
        """Return the point (x, y) about v^2 / (2 a_max) ahead, differentiable also at rest."""
        x, y, vx, vy = state
        least = ROUNDED_SHARE * self.speed_max_m_s
        ahead_s = 0.5 * (vx * vx + vy * vy + least**2) ** 0.5 / self.acceleration_max_m_s2
        return x + ahead_s * vx, y + ahead_s * vy

    def braking(self, state: Floats, step_s: float, steps: int) -> Floats:
        """Return inputs of constant deceleration over the fewest possible steps, then zero."""
        inputs = np.zeros((steps, 2))
        needed = self.stop_steps(state, step_s)
        if needed:
            inputs[:needed] = -state[2:] / (needed * step_s)
        return inputs

    def following(self, state: Floats, path_m: Floats, step_s: float) -> Floats:
        """Return inputs that follow the path by pure pursuit, slower at turns and the end."""
        pursuit = PurePursuit(np.vstack([state[:2], path_m]))
        lookahead_m = self.speed_max_m_s * step_s
        deceleration = BRAKING_SHARE * self.acceleration_max_m_s2
        here = tuple(state)
        inputs = np.zeros((len(path_m), 2))
        for k in range(len(path_m)):
            place, velocity = np.array(here[:2]), np.array(here[2:])
            target, left_m = pursuit.ahead_m(place, lookahead_m)
            offset = target - place
            length = float(np.hypot(*offset))
            speed = min(
                self.speed_max_m_s,
                pursuit.speed_m_s(deceleration, SWING_SHARE * lookahead_m),
                left_m / step_s,
            )
            desired = offset * (speed / length) if length > 0.0 else np.zeros(2)
            control = (desired - velocity) / step_s
            over = float(np.hypot(*control)) / self.acceleration_max_m_s2
            inputs[k] = control / max(over, 1.0)
            here = self.step(here, tuple(inputs[k]), step_s)
        return inputs

    def straight(self, state: Floats, end_m: Floats, step_s: float) -> Floats:
        """Return inputs of a straight drive: n accelerating steps, then n braking steps."""
        offset = end_m - state[:2]
        length = float(np.hypot(*offset))
        by_speed = length / (self.speed_max_m_s * step_s)
        by_acceleration = math.sqrt(length / self.acceleration_max_m_s2) / step_s
        half = max(1, math.ceil(max(by_speed, by_acceleration) - 1e-9))
        control = offset / (half * step_s) ** 2
        return np.repeat([control, -control], half, axis=0)

    def may_reach(self, state: Floats, places_m: Floats, duration_s: float, slack_m: float) -> Mask:
        """Return a mask of positions reachable in `duration_s`, with a margin of `slack_m`."""
        offset = places_m - (state[:2] + duration_s * state[2:])
        radius = 0.5 * self.acceleration_max_m_s2 * duration_s**2
        return np.hypot(offset[:, 0], offset[:, 1]) <= radius + slack_m

    def curves(self, states: Floats, inputs: Floats, step_s: float) -> list[StepCurve]:
        """Return each step's path as a parabola."""
        half = 0.5 * step_s * step_s
        return [
            Parabola(state[:2], step_s * state[2:], half * control)
            for state, control in zip(states, inputs, strict=True)
        ]

    def excess_m(self, states: Floats, inputs: Floats, step_s: float) -> float:
        """Return the largest excess over the limits, in metres per step; NaN if undefined."""
        acceleration = np.hypot(inputs[:, 0], inputs[:, 1]) - self.acceleration_max_m_s2
        speed = np.hypot(states[:, 2], states[:, 3]) - self.speed_max_m_s
        return float(np.max(np.concatenate([0.5 * step_s * step_s * acceleration, step_s * speed])))

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """Return the displacement per unit of state: 1 m for position, `step_s` m for velocity."""
        return (1.0, 1.0, step_s, step_s)


@dataclass(frozen=True)
class Unicycle(Dynamics):
    """Robot that drives along its heading, such as a differential drive.

    x' = v cos(heading), y' = v sin(heading), heading' = w. A step is a circular arc. With half the
    turn z = w h / 2, its chord has length v h sin(z)/z and direction heading + z. The arc lies in
    the triangle of its ends and the intersection of its end tangents, v h tan(z) / (2 z) ahead.

    Attributes
    ----------
    speed_max_m_s, speed_min_m_s
        Largest and smallest forward speed; negative values mean reversing. The smallest is at most
        0, so that the robot can stop.
    turn_rate_max_rad_s
        Largest turn rate in either direction.
    """

    speed_max_m_s: float
    turn_rate_max_rad_s: float
    speed_min_m_s: float = 0.0

    kind = "unicycle"
    state_names = ("x_m", "y_m", "heading_rad")
    input_names = ("speed_m_s", "turn_rate_rad_s")

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """Return the exact state after a step."""
        (x, y, heading), (speed, rate) = state, control
        half = 0.5 * step_s * rate
        chord = step_s * speed * sinc(half)
        return (
            x + chord * cosine(heading + half),
            y + chord * sine(heading + half),
            heading + step_s * rate,
        )

    def limits(self, control: Components, after: Components) -> Components:
        """Return scaled limits of speed and turn rate, which must be <= 0."""
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
        """Return the joints of the arc's pieces and the intersections of their end tangents."""
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

    def timed_pad_m(self, step_s: float) -> float:
        """Return the largest distance of the arc from the arc's Bezier curves at equal times."""
        # Let r be the radius, z half the turn and u in [-1, 1] time. The arc is at ``r sin(u z)``
        # along the chord and ``r (cos(u z) - cos z)`` across it; the curve is at ``r u sin(z)`` and
        # ``r (1 - u^2) sin^2(z) / (2 cos z)``. The difference along the chord is largest if ``cos(u
        # z) = sin(z) / z``, across at u = 0. Both increase with speed and turn rate.
        half = 0.5 * self.turn_rate_max_rad_s * step_s / self._pieces(step_s)
        speed = max(self.speed_max_m_s, -self.speed_min_m_s)
        farthest = math.acos(math.sin(half) / half)
        along = math.sin(farthest) - farthest / half * math.sin(half)
        across = 0.5 * math.sin(half) * math.tan(half) - (1.0 - math.cos(half))
        return speed / self.turn_rate_max_rad_s * math.hypot(along, across)

    def turning_s(self, state: Components, place: tuple[Any, Any]) -> Any:
        """Return a smooth estimate of the time to turn towards a position; 0 at the position."""
        # pi / (2 w_max) (1 - cos b) d / (d + r) at bearing b and distance d (equation 6.2).
        x, y = place[0] - state[0], place[1] - state[1]
        circle_m = self.speed_max_m_s / self.turn_rate_max_rad_s
        distance = (x * x + y * y + (ROUNDED_SHARE * circle_m) ** 2) ** 0.5
        ahead = x * cosine(state[2]) + y * sine(state[2])
        half_turn_s = math.pi / self.turn_rate_max_rad_s
        return 0.5 * half_turn_s * (distance - ahead) / (distance + circle_m)

    def following(self, state: Floats, path_m: Floats, step_s: float) -> Floats:
        """Return inputs that follow the path by pure pursuit, with turns on the spot."""
        pursuit = PurePursuit(np.vstack([state[:2], path_m]))
        here = tuple(state)
        inputs = np.zeros((len(path_m), 2))
        for k in range(len(path_m)):
            place = np.array(here[:2])
            target, left_m = pursuit.ahead_m(place, self.speed_max_m_s * step_s)
            inputs[k] = self._inputs_towards(target - place, float(here[2]), left_m, step_s)
            here = self.step(here, tuple(inputs[k]), step_s)
        return inputs

    def _inputs_towards(
        self, offset_m: Floats, heading: float, left_m: float, step_s: float
    ) -> tuple[float, float]:
        """Return speed and turn rate of the arc that leads to a point from the current heading."""
        distance = float(np.hypot(*offset_m))
        if distance <= 1e-9 or left_m <= 0.0:
            return 0.0, 0.0
        bearing = math.remainder(math.atan2(offset_m[1], offset_m[0]) - heading, 2.0 * math.pi)
        if abs(bearing) > math.pi / 3.0:
            limit = self.turn_rate_max_rad_s
            return 0.0, min(max(bearing / step_s, -limit), limit)
        curvature = 2.0 * math.sin(bearing) / distance
        speed = min(self.speed_max_m_s, left_m / step_s)
        if abs(curvature) * speed > self.turn_rate_max_rad_s:
            speed = self.turn_rate_max_rad_s / abs(curvature)
        return speed, speed * curvature

    def straight(self, state: Floats, end_m: Floats, step_s: float) -> Floats:
        """Return inputs of a turn on the spot, then of a straight drive."""
        offset = end_m - state[:2]
        bearing = math.atan2(offset[1], offset[0]) - float(state[2])
        angle = math.remainder(bearing, 2.0 * math.pi)
        turns = math.ceil(abs(angle) / (self.turn_rate_max_rad_s * step_s) - 1e-9)
        length = float(np.hypot(*offset))
        ahead = max(1, math.ceil(length / (self.speed_max_m_s * step_s) - 1e-9))
        inputs = np.zeros((turns + ahead, 2))
        inputs[:turns, 1] = angle / (max(turns, 1) * step_s)
        inputs[turns:, 0] = length / (ahead * step_s)
        return inputs

    def may_reach(self, state: Floats, places_m: Floats, duration_s: float, slack_m: float) -> Mask:
        """Return a mask of positions within the robot's range in each of several directions."""
        rate = self.turn_rate_max_rad_s

        def farthest_m(speed: float, angle: Floats) -> Floats:
            # In a direction at an angle b from the heading, the speed is at most v cos(b - w t).
            first = np.minimum(angle, 0.5 * math.pi)
            last = np.clip(angle - rate * duration_s, 0.0, 0.5 * math.pi)
            straight_s = np.maximum(duration_s - angle / rate, 0.0)
            return speed * ((np.sin(first) - np.sin(last)) / rate + straight_s)

        angle = np.linspace(0.0, math.pi, DIRECTIONS)
        reach_m = farthest_m(self.speed_max_m_s, angle)
        reach_m += farthest_m(-self.speed_min_m_s, math.pi - angle)
        ahead = np.array([math.cos(state[2]), math.sin(state[2])])
        offset = places_m - state[:2]
        along, across = offset @ ahead, np.abs(offset @ np.array([-ahead[1], ahead[0]]))
        there = np.outer(along, np.cos(angle)) + np.outer(across, np.sin(angle))
        return np.asarray((there <= reach_m + slack_m).all(axis=1), dtype=np.bool_)

    def curves(self, states: Floats, inputs: Floats, step_s: float) -> list[StepCurve]:
        """Return each step's path as a circular arc."""
        return [
            Arc(state[:2], float(state[2]), step_s * float(speed), step_s * float(rate))
            for state, (speed, rate) in zip(states, inputs, strict=True)
        ]

    def excess_m(self, states: Floats, inputs: Floats, step_s: float) -> float:
        """Return the largest excess over the limits, in metres per step; NaN if undefined."""
        speed = np.maximum(inputs[:, 0] - self.speed_max_m_s, self.speed_min_m_s - inputs[:, 0])
        rate = np.abs(inputs[:, 1]) - self.turn_rate_max_rad_s
        sideways = 0.5 * step_s * step_s * self.speed_max_m_s * rate
        return float(np.max(np.concatenate([step_s * speed, sideways])))

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """Return displacements in m per unit of each state: for a heading, a step at full speed."""
        return (1.0, 1.0, self.speed_max_m_s * step_s)


def sine(angle: Any) -> Any:
    """Return the sine of an angle in rad, a number, array or expression."""
    return angle.sin() if hasattr(angle, "sin") else np.sin(angle)


def cosine(angle: Any) -> Any:
    """Return the cosine of an angle in rad, a number, array or expression."""
    return angle.cos() if hasattr(angle, "cos") else np.cos(angle)


def sinc(angle: Any) -> Any:
    """Return sin(z) / z, 1 at zero, accurate to rounding error for angles up to about 3 rad."""
    # The identity sin(z) = 2 sin(z/2) cos(z/2) is applied three times; a series gives the rest.
    rest = angle / 2.0**HALVINGS
    square = rest * rest
    series = 1.0 - square / 6.0 * (
        1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0 * (1.0 - square / 110.0)))
    )
    for halving in range(1, HALVINGS + 1):
        series = series * cosine(angle / 2.0**halving)
    return series
