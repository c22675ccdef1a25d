"""A moving target and what is known of it at the start."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
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
    """

    name: str
    start_m: tuple[float, float]
    velocity_m_s: tuple[float, float]
    acceleration_std_m_s2: float
    position_std_m: float
    velocity_std_m_s: float
