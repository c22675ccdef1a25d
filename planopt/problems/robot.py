"""A robot of a problem: where it starts, and how it may move."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Robot:
    """One robot.

    Attributes
    ----------
    name
        What outputs call it.
    start_m
        ``(x, y)`` in metres.
    goal_m
        Where it must go; None unless the task is to reach a goal.
    speed_max_m_s
        Largest speed: the input set is the disc of this radius (single integrator).
    """

    name: str
    start_m: tuple[float, float]
    goal_m: tuple[float, float] | None
    speed_max_m_s: float
