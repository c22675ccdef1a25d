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
    """A moving target and what is known of it at the start (equation 4.7).

    Attributes
    ----------
    name
        What outputs call it.
    start_m, velocity_m_s
        Where it truly is and how it moves at the start, ``(x, y)``.
    acceleration_std_m_s2
        Standard deviation of the white acceleration along either axis (Theta is its square).
    position_std_m, velocity_std_m_s
        Deviation of the first estimate of position and velocity along either axis (P_0).
    start_distance_m
        Where given, it starts so far from ``start_m`` in a direction drawn with the random seed,
        and moves away from there at the speed of ``velocity_m_s``.
    heading_spread_rad
        Its first heading is then off that direction by up to this angle, drawn as well.
    stays_free
        Whether its path is drawn again until it stays within the bounds and out of obstacles.
    packets
        ``measurements``: a packet has the robot's last measurement of the target, as in [GM11].
        ``estimates``: it has the robot's own estimate, so that the station knows all that the
        robot has measured so far.
    packet_delay_steps
        The station has a packet so many steps after it was sent.
    """

    at = "targets[]"

    name: Annotated[Name, Field(description="What outputs call it.")] = "target"
    start_m: Annotated[Pair, Field(description="Where it truly starts, [x, y] in metres.")]
    velocity_m_s: Annotated[
        Pair, Field(description="Its true velocity at the start, [x, y] in m/s.")
    ]
    acceleration_std_m_s2: Annotated[
        float,
        Field(
            ge=0,
            le=1e6,
            description="Deviation of its white acceleration along an axis, in m/s^2.",
        ),
    ] = 0.03
    position_std_m: Annotated[
        float,
        Field(ge=LEAST_STD, le=1e6, description="Deviation of its first estimated position, in m."),
    ] = 1.0
    velocity_std_m_s: Annotated[
        float,
        Field(
            ge=LEAST_STD, le=1e6, description="Deviation of its first estimated velocity, in m/s."
        ),
    ] = 0.3
    start_distance_m: Annotated[
        float | None,
        Field(
            ge=0,
            le=1e6,
            description="Where given, it starts so many metres from start_m in a direction drawn "
            "with the random seed, and moves away from there at the speed of velocity_m_s.",
        ),
    ] = None
    heading_spread_rad: Annotated[
        float,
        Field(
            ge=0,
            le=3.2,
            description="Its first heading is then off that direction by up to so many rad.",
        ),
    ] = 0.0
    stays_free: Annotated[
        bool,
        Field(
            description="Draw its path again until it stays within the bounds and out of obstacles "
            "(true or false)."
        ),
    ] = False
    packets: Annotated[
        Packets,
        Field(
            description="measurements (a packet has the robot's last measurement of the target) or "
            "estimates (it has the robot's own estimate: the station then knows all that the robot "
            "has measured)."
        ),
    ] = "measurements"
    packet_delay_steps: Annotated[
        int,
        Field(
            ge=0, le=1000, description="The station has a packet so many steps after it is sent."
        ),
    ] = 0
