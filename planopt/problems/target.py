"""A moving target and what is known of it at the start."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.plain_values import make_plain


@dataclass(frozen=True, kw_only=True)
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

    name: str = "target"
    start_m: tuple[float, float]
    velocity_m_s: tuple[float, float]
    acceleration_std_m_s2: float = 0.03
    position_std_m: float = 1.0
    velocity_std_m_s: float = 0.3

    def __post_init__(self) -> None:
        make_plain(self)
