"""A moving target and what is known of it at the start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from planopt.problems.tables import Name, Pair, Part

Packets = Literal["measurements", "estimates"]
"""What a packet to the station has of the target."""

LEAST_STD = 1e-6
"""Of a first estimate in metres or m/s: its information is still a number that can be inverted."""


@dataclass(frozen=True, kw_only=True)
class Target(Part):
    """A moving target and what is known of it at the start (equation 4.7)."""

    at = "targets[]"

    name: Name = "target"
    """What outputs call it."""
    start_m: Pair
    """Where it truly starts, [x, y] in metres."""
    velocity_m_s: Pair
    """Its true velocity at the start, [x, y] in m/s."""
    acceleration_std_m_s2: Annotated[float, Field(ge=0, le=1e6)] = 0.03
    """Deviation of its white acceleration along an axis, in m/s^2."""
    position_std_m: Annotated[float, Field(ge=LEAST_STD, le=1e6)] = 1.0
    """Deviation of its first estimated position, in m."""
    velocity_std_m_s: Annotated[float, Field(ge=LEAST_STD, le=1e6)] = 0.3
    """Deviation of its first estimated velocity, in m/s."""
    start_distance_m: Annotated[float | None, Field(ge=0, le=1e6)] = None
    """Where given, it starts so many metres from start_m in a direction drawn with the random seed,
    and moves away from there at the speed of velocity_m_s."""
    heading_spread_rad: Annotated[float, Field(ge=0, le=3.2)] = 0.0
    """Its first heading is then off that direction by up to so many rad."""
    stays_free: bool = False
    """Draw its path again until it stays within the bounds and out of obstacles (true or false)."""
    packets: Packets = "measurements"
    """measurements (a packet has the robot's last measurement of the target) or estimates (it has
    the robot's own estimate: the station then knows all that the robot has measured)."""
    packet_delay_steps: Annotated[int, Field(ge=0, le=1000)] = 0
    """The station has a packet so many steps after it is sent."""
