"""A robot of a problem: where it starts, and how it may move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, listed
from planopt.parts import class_name
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
        if self.dynamics is not None:
            _require_dynamics(self.dynamics)
        if self.dynamics is not None and not self.start_rest:
            rest = (0.0,) * (len(self.dynamics.state_names) - 2)
            object.__setattr__(self, "start_rest", rest)

    @property
    def start_state(self) -> NDArray[np.float64]:
        """``(s,)`` the state at the start, its place first."""
        return np.array([*self.start_m, *self.start_rest], dtype=np.float64)


def _require_dynamics(given: object) -> None:
    """Refuse what has not all attributes and methods of dynamics."""
    named = {name: part for name, part in vars(Dynamics).items() if not name.startswith("_")}
    if isinstance(given, str | type):
        missing = list(named)
    else:
        # A class that derives from the protocol has its empty methods.
        missing = [
            name
            for name, part in named.items()
            if getattr(type(given), name, None) is part or not hasattr(given, name)
        ]
    if len(missing) == len(named):
        raise InputError(
            f"is {given!r}, no object with dynamics",
            key="robots[].dynamics",
            remedy="give planopt.problems.DoubleIntegrator(...), Unicycle(...), "
            "planopt.extend.CasadiMap(...) or your own, or none for a robot that moves at will",
        )
    if missing:
        raise InputError(
            f"{class_name(given)} lacks {listed(missing)}",
            key="robots[].dynamics",
            remedy="define what planopt.extend.Dynamics has, or give a planopt.extend.CasadiMap",
        )
