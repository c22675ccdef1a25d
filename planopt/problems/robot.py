"""A robot of a problem: where it starts, and how it may move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.robots.dynamics import Dynamics


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
        Largest speed; of a single integrator the input set is the disc of this radius.
    dynamics
        How it moves; None for the single integrator.
    start_rest
        What its state at the start has beyond its place, in the order of ``dynamics.state_names``.
    """

    name: str
    start_m: tuple[float, float]
    goal_m: tuple[float, float] | None
    speed_max_m_s: float
    dynamics: Dynamics | None = None
    start_rest: tuple[float, ...] = ()

    @property
    def start_state(self) -> NDArray[np.float64]:
        """``(s,)`` the state at the start, its place first."""
        return np.array([*self.start_m, *self.start_rest], dtype=np.float64)
