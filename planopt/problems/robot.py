"""A robot of a problem: where it starts, and how it may move."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict, model_validator

from planopt.errors import InputError, listed
from planopt.keys import Name, Pair, Part, Table, fault_of
from planopt.parts import class_name
from planopt.robots.dynamics import Dynamics
from planopt.robots.models import DoubleIntegrator, SingleIntegrator, Unicycle

DynamicsName = Literal["single_integrator", "double_integrator", "unicycle"]

KEYS: dict[DynamicsName, tuple[str, ...]] = {
    "single_integrator": (),
    "double_integrator": ("acceleration_max_m_s2", "start_velocity_m_s"),
    "unicycle": ("turn_rate_max_rad_s", "speed_min_m_s", "start_heading_rad"),
}
"""The keys that go only with some dynamics."""

NEEDED: dict[DynamicsName, str] = {
    "double_integrator": "acceleration_max_m_s2",
    "unicycle": "turn_rate_max_rad_s",
}
"""The key that each requires."""

LEAST_LIMIT = 1e-6
"""In m/s^2 or rad/s: solvers divide by the square of it."""


class DynamicsKeys(Table):
    """The keys of ``[[robots]]`` that describe its dynamics and its state at the start."""

    dynamics: DynamicsName = "single_integrator"
    """How it moves: single_integrator (turns and stops at will), double_integrator (bounded
    acceleration) or unicycle (drives where it faces)."""
    acceleration_max_m_s2: float | None = Field(default=None, gt=0, le=1e4)
    """Largest acceleration of a double integrator."""
    start_velocity_m_s: Pair | None = None
    """Velocity [x, y] of a double integrator at the start in m/s; 0 if absent."""
    turn_rate_max_rad_s: float | None = Field(default=None, gt=0, le=1e3)
    """Largest turn rate of a unicycle in rad/s."""
    speed_min_m_s: float | None = Field(default=None, ge=-1000, le=0)
    """Least speed of a unicycle in m/s, below 0 if it drives backward; 0 if absent."""
    start_heading_rad: Annotated[float, Field(ge=-100, le=100)] | None = None
    """Heading of a unicycle at the start in rad, from the x axis; 0 if absent."""

    @model_validator(mode="after")
    def _fits_the_dynamics(self) -> DynamicsKeys:
        for dynamics, keys in KEYS.items():
            given = [key for key in keys if getattr(self, key) is not None]
            if given and dynamics != self.dynamics:
                raise fault_of(
                    f"has {given[0]}, which goes only with dynamics {dynamics}: leave it out, or "
                    f'write dynamics = "{dynamics}"'
                )
        needed = NEEDED.get(self.dynamics)
        if needed is not None and getattr(self, needed) is None:
            raise fault_of(
                f"has dynamics {self.dynamics}, which needs {needed}: write {needed} = 1.0"
            )
        if needed is not None and getattr(self, needed) < LEAST_LIMIT:
            raise fault_of(
                f"has {needed} below {LEAST_LIMIT:g}, with which it hardly moves: give a larger "
                "one, such as 1.0"
            )
        return self


@dataclass(frozen=True, kw_only=True)
class Robot(Part):
    """One robot, how it moves, and where it must go.

    Examples
    --------
    >>> from planopt import Robot
    >>> Robot(start_m=(5.0, 5.0), goal_m=(90.0, 60.0), speed_max_m_s=2.0).name
    'robot'
    """

    at = "robots[]"
    Keys = DynamicsKeys
    not_keys = frozenset({"dynamics", "start_rest"})

    start_m: Pair
    """Start [x, y] in metres."""
    goal_m: Pair | None = None
    """Goal [x, y] in metres, for the task reach and terms of kind goal."""
    speed_max_m_s: Annotated[float, Field(gt=0, le=1000)]
    """Largest speed in m/s."""
    name: Name = "robot"
    """What outputs call it."""
    dynamics: Dynamics = field(default_factory=SingleIntegrator)
    """How it moves; a single integrator has its speed_max_m_s."""
    start_rest: tuple[float, ...] = ()
    """State at the start beyond its position, in the order of dynamics.state_names; 0 if absent."""
    start_spread_m: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """It starts at a place within so many metres of start_m, drawn with the random seed; not for
    the task reach."""
    weights: Annotated[tuple[Annotated[float, Field(ge=0, le=1e9)], ...], Strict(False)] = ()
    """For tasks other than reach: weight of each of objective.terms for this robot, in their order,
    in place of their own. A term of weight 0 is none of its terms."""

    def __post_init__(self) -> None:
        rest = _start_rest(self.dynamics, cast("object", self.start_rest))
        object.__setattr__(self, "start_rest", rest)
        super().__post_init__()
        if self.moves_freely:
            object.__setattr__(self, "dynamics", SingleIntegrator(self.speed_max_m_s))

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of its table; dynamics from Python have none."""
        keys, rest = super().to_keys(), self.start_rest
        match self.dynamics:
            case DoubleIntegrator(acceleration_max_m_s2=largest):
                own = {"acceleration_max_m_s2": largest, "start_velocity_m_s": rest}
            case Unicycle(turn_rate_max_rad_s=largest, speed_min_m_s=least):
                own = {
                    "turn_rate_max_rad_s": largest,
                    "speed_min_m_s": least,
                    "start_heading_rad": rest[0],
                }
            case _:
                return keys
        return {**keys, "dynamics": self.dynamics.kind, **own}

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the robot's fields, its dynamics among them."""
        speed = table.speed_max_m_s
        match table.dynamics:
            case "double_integrator":
                dynamics = DoubleIntegrator(speed, table.acceleration_max_m_s2)
                rest = table.start_velocity_m_s or (0.0, 0.0)
            case "unicycle":
                dynamics = Unicycle(speed, table.turn_rate_max_rad_s, table.speed_min_m_s or 0.0)
                rest = (table.start_heading_rad or 0.0,)
            case _:
                dynamics, rest = SingleIntegrator(speed), ()
        return {**super().of_keys(table), "dynamics": dynamics, "start_rest": rest}

    def fault(self) -> str | None:
        """Return why it cannot start as it is said to."""
        rest = self.start_rest if isinstance(self.dynamics, DoubleIntegrator) else ()
        if sum(each * each for each in rest) > self.speed_max_m_s**2:
            return (
                "has a start_velocity_m_s that is faster than speed_max_m_s: lessen it, or raise "
                "speed_max_m_s"
            )
        return None

    @property
    def moves_freely(self) -> bool:
        """Return whether positions alone describe how it moves: it turns and stops at will."""
        return isinstance(self.dynamics, SingleIntegrator)

    @property
    def start_state(self) -> NDArray[np.float64]:
        """Return the state at the start ``(s,)``, its position first."""
        return np.array([*self.start_m, *self.start_rest], dtype=np.float64)


def _start_rest(dynamics: Dynamics, given: object) -> tuple[float, ...]:
    """Return the state at the start beyond the place, as the dynamics need it."""
    _require_dynamics(dynamics)
    rest = dynamics.state_names[2:]
    values = tuple(cast("Any", given)) if isinstance(given, list | tuple | np.ndarray) else None
    if values == ():
        return (0.0,) * len(rest)
    if values is None or len(values) != len(rest) or not _are_finite(values):
        raise InputError(
            f"has the start_rest {given!r}, should have finite numbers for {listed(rest)}",
            key=Robot.at,
            remedy=f"start_rest is the state of a {dynamics.kind} beyond its place",
        )
    return tuple(float(value) for value in values)


def _are_finite(values: tuple[Any, ...]) -> bool:
    return all(isinstance(one, int | float | np.number) for one in values) and bool(
        np.isfinite(values).all()
    )


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
            "planopt.extend.CasadiMap(...) or your own, or leave it out for a single integrator",
        )
    if missing:
        raise InputError(
            f"{class_name(given)} lacks {listed(missing)}",
            key="robots[].dynamics",
            remedy="define what planopt.extend.Dynamics has, or give a planopt.extend.CasadiMap",
        )
