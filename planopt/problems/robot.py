"""A robot of a problem: where it starts, and how it may move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.plain_values import make_plain
from planopt.robots.dynamics import Dynamics


@dataclass(frozen=True, kw_only=True)
class Robot:
    """One robot.

    Attributes
    ----------
    start_m
        Start ``(x, y)`` in metres.
    goal_m
        Where it must go; None unless the task is to reach a goal.
    speed_max_m_s
        Largest speed; of a single integrator the input set is the disc of this radius.
    name
        Name in outputs.
    dynamics
        How it moves; None for the single integrator.
    start_rest
        Components of its state at the start beyond its place, in the order of
        ``dynamics.state_names``; all zero where they are left out.
    start_spread_m
        It starts within this distance of ``start_m``, at a place drawn with the random seed.
    weights
        Of each term of the objective, for this robot: in place of the term's own, where they are
        given. A term of weight 0 is none of its terms.

    Examples
    --------
    >>> from planopt import Robot
    >>> Robot(start_m=(5.0, 5.0), goal_m=(90.0, 60.0), speed_max_m_s=2.0).name
    'robot'
    """

    start_m: tuple[float, float]
    goal_m: tuple[float, float] | None = None
    speed_max_m_s: float
    name: str = "robot"
    dynamics: Dynamics | None = None
    start_rest: tuple[float, ...] = ()
    start_spread_m: float = 0.0
    weights: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        make_plain(self)
        if isinstance(self.dynamics, str | type):
            raise InputError(
                f"is {self.dynamics!r}, should be an object",
                key="robots[].dynamics",
                remedy="give planopt.problems.DoubleIntegrator(...), Unicycle(...) or your own, or "
                "none for a robot that moves as it will",
            )
        if self.dynamics is not None and not self.start_rest:
            rest = (0.0,) * (len(self.dynamics.state_names) - 2)
            object.__setattr__(self, "start_rest", rest)

    @property
    def start_state(self) -> NDArray[np.float64]:
        """``(s,)`` the state at the start, its place first."""
        return np.array([*self.start_m, *self.start_rest], dtype=np.float64)
