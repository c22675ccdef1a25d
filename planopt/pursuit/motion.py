"""The motion of pursuers towards a point: straight, or as a unicycle with turns or arcs.

States are arrays whose last axis begins with x and y, so that many are driven at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.pursuit.service import require_number
from planopt.robots.models import Unicycle

ARRIVED_M = 1e-9
"""Nearer than this a point is reached: its bearing no longer means anything."""


class Motion(Protocol):
    """The motion of an object."""

    @property
    def speed_max_m_s(self) -> float:
        """It is never faster."""
        ...

    @property
    def turning_s(self) -> float:
        """Return how much longer a point may take than a straight line to it."""
        ...

    def start(self, place_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the state at rest at a place (2,)."""
        ...

    def towards(
        self, states: NDArray[np.float64], aims_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Return the states (..., s) after a step towards points (..., 2)."""
        ...


@dataclass(frozen=True)
class StraightMotion:
    """A single integrator: it turns and stops at will."""

    speed_max_m_s: float  # Largest speed

    def __post_init__(self) -> None:
        require_number(self.speed_max_m_s, "speed_max_m_s", above=0.0)

    @property
    def turning_s(self) -> float:
        """Return 0: it turns at once."""
        return 0.0

    def start(self, place_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the place."""
        return place_m

    def towards(
        self, states: NDArray[np.float64], aims_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Drive straight, and stop at the point."""
        offset = aims_m - states
        away = np.linalg.norm(offset, axis=-1, keepdims=True)
        share = np.minimum(1.0, self.speed_max_m_s * step_s / np.maximum(away, ARRIVED_M))
        return states + share * offset


@dataclass(frozen=True)
class UnicycleMotion:
    """A unicycle that turns on the spot and drives straight, or drives an arc if that is faster."""

    robot: Unicycle  # Its limits

    @property
    def speed_max_m_s(self) -> float:
        """Forward."""
        return self.robot.speed_max_m_s

    @property
    def turning_s(self) -> float:
        """Return the time of half a turn on the spot."""
        return math.pi / self.robot.turn_rate_max_rad_s

    def start(self, place_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the place with heading 0."""
        return np.append(place_m, 0.0)

    def towards(
        self, states: NDArray[np.float64], aims_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Turn and drive; inputs are constant over each of the two parts of the step.

        The arc to a point at bearing b and distance d is ``d b / sin b`` long and turns by 2 b. It
        is driven if that takes less than turning by b and driving d.
        """
        speed, rate = self.robot.speed_max_m_s, self.robot.turn_rate_max_rad_s
        offset = aims_m - states[..., :2]
        away = np.linalg.norm(offset, axis=-1)
        bearing = np.arctan2(offset[..., 1], offset[..., 0]) - states[..., 2]
        bearing = np.where(away > ARRIVED_M, np.remainder(bearing + np.pi, 2 * np.pi) - np.pi, 0.0)
        # Half a turn of an arc is no way to a point behind.
        ahead = np.abs(bearing) < 0.5 * np.pi
        along = away / np.sinc(np.where(ahead, bearing, 0.0) / np.pi)
        arc_s = np.maximum(along / speed, 2.0 * np.abs(bearing) / rate)
        spot_s = np.abs(bearing) / rate
        arcs = ahead & (arc_s <= spot_s + away / speed)
        turn_s = np.where(arcs, 0.0, np.minimum(spot_s, step_s))
        turned = self._after(states, np.zeros_like(away), rate * np.sign(bearing), turn_s)
        lasts_s = np.where(arcs, arc_s, away / speed)
        drive_s = np.minimum(step_s - turn_s, lasts_s)
        some = np.maximum(lasts_s, ARRIVED_M)
        forward = np.asarray(np.where(arcs, along, away), dtype=np.float64) / some
        return self._after(turned, forward, np.where(arcs, 2.0 * bearing / some, 0.0), drive_s)

    def _after(
        self,
        states: NDArray[np.float64],
        speed_m_s: NDArray[np.float64],
        rate_rad_s: NDArray[np.float64],
        lasts_s: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Exact steps of the robot, as inputs times their duration over one second."""
        moved = self.robot.step(
            (states[..., 0], states[..., 1], states[..., 2]),
            (speed_m_s * lasts_s, rate_rad_s * lasts_s),
            1.0,
        )
        return np.stack(moved, axis=-1)
