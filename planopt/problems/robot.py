"""Robot of a problem: initial state, dynamics and goal."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import Field, Strict, model_validator

from planopt.arrays import Floats
from planopt.errors import InputError, listed
from planopt.keys import Name, Pair, Part, Table, fault_of
from planopt.parts import class_name
from planopt.robots.dynamics import NO_DEFAULT, Dynamics
from planopt.robots.models import DoubleIntegrator, SingleIntegrator, Unicycle

DynamicsName = Literal["single_integrator", "double_integrator", "unicycle"]

KEYS: dict[DynamicsName, tuple[str, ...]] = {
    "single_integrator": (),
    "double_integrator": ("acceleration_max_m_s2", "start_velocity_m_s"),
    "unicycle": ("turn_rate_max_rad_s", "speed_min_m_s", "start_heading_rad"),
}
"""Keys specific to each type of dynamics."""
NEEDED: dict[DynamicsName, str] = {
    "double_integrator": "acceleration_max_m_s2",
    "unicycle": "turn_rate_max_rad_s",
}
"""Key required by each type of dynamics."""
LEAST_LIMIT = 1e-6
"""Minimum limit of acceleration (m/s^2) or turn rate (rad/s); solvers divide by its square."""


class DynamicsKeys(Table):
    """Keys of ``[[robots]]`` for dynamics and initial state."""

    dynamics: DynamicsName = "single_integrator"
    """Dynamics: single_integrator (holonomic), double_integrator (bounded acceleration) or unicycle
    (drives along its heading)."""
    acceleration_max_m_s2: float | None = Field(default=None, gt=0, le=1e4)
    """Largest acceleration of a double integrator in m/s^2."""
    start_velocity_m_s: Pair | None = None
    """Initial velocity [x, y] of a double integrator in m/s; default: 0."""
    turn_rate_max_rad_s: float | None = Field(default=None, gt=0, le=1e3)
    """Largest turn rate of a unicycle in rad/s."""
    speed_min_m_s: float | None = Field(default=None, ge=-1000, le=0)
    """Minimum speed of a unicycle in m/s, negative for reverse driving; default: 0."""
    start_heading_rad: Annotated[float, Field(ge=-100, le=100)] | None = None
    """Initial heading of a unicycle in rad from the x axis; default: 0."""

    @model_validator(mode="after")
    def _fits_the_dynamics(self) -> DynamicsKeys:
        for dynamics, keys in KEYS.items():
            given = [key for key in keys if getattr(self, key) is not None]
            if given and dynamics != self.dynamics:
                raise fault_of(
                    f"has {given[0]}, which applies only to the dynamics {dynamics}: leave it "
                    f'out, or write dynamics = "{dynamics}"'
                )
        needed = NEEDED.get(self.dynamics)
        if needed is not None and getattr(self, needed) is None:
            raise fault_of(
                f"has the dynamics {self.dynamics}, which need {needed}: write for instance "
                f"{needed} = 1.0"
            )
        if needed is not None and getattr(self, needed) < LEAST_LIMIT:
            raise fault_of(
                f"has {needed} below {LEAST_LIMIT:g}, so that it hardly moves: give a larger "
                "value, such as 1.0"
            )
        return self


@dataclass(frozen=True, kw_only=True)
class Robot(Part):
    """Robot with its initial state, dynamics and goal.

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
    """Name in outputs."""
    dynamics: Dynamics = field(default_factory=SingleIntegrator)
    """Dynamics; a single integrator uses speed_max_m_s."""
    start_rest: tuple[float, ...] = ()
    """Initial state without the position, in the order of dynamics.state_names; default: 0."""
    start_spread_m: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Radius in metres around start_m within which the start is drawn with the random seed; not
    for the task reach."""
    weights: Annotated[tuple[Annotated[float, Field(ge=0, le=1e9)], ...], Strict(False)] = ()
    """For tasks other than reach: this robot's weights of objective.terms, in the order of the
    terms; they replace the terms' weights. A weight of 0 removes the term."""

    def __post_init__(self) -> None:
        rest = _start_rest(self.dynamics, cast("object", self.start_rest))
        object.__setattr__(self, "start_rest", rest)
        super().__post_init__()
        if self.moves_freely:
            object.__setattr__(self, "dynamics", SingleIntegrator(self.speed_max_m_s))

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of the table; dynamics defined in Python have no keys."""
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
        """Return the fields of the robot, including its dynamics."""
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
        """Return a message if the speed limits differ or the initial state is invalid."""
        own, speed = self.dynamics.speed_max_m_s, self.speed_max_m_s
        if not self.moves_freely and own != speed:
            return (
                f"has speed_max_m_s {speed:g} and dynamics with speed_max_m_s {own:g}: give both "
                "the same limit"
            )
        rest = self.start_rest if isinstance(self.dynamics, DoubleIntegrator) else ()
        if sum(each * each for each in rest) > self.speed_max_m_s**2:
            return (
                "has a start_velocity_m_s that is faster than speed_max_m_s: reduce it, or "
                "increase speed_max_m_s"
            )
        return None

    @cached_property
    def moves_freely(self) -> bool:
        """Return True if the robot is a single integrator, whose state is its position."""
        return isinstance(self.dynamics, SingleIntegrator)

    @property
    def start_state(self) -> Floats:
        """Return the initial state ``(s,)``, position first."""
        return np.array([*self.start_m, *self.start_rest], dtype=np.float64)


def _start_rest(dynamics: Dynamics, given: object) -> tuple[float, ...]:
    """Return the initial state without the position, in the order of the dynamics' states."""
    _require_dynamics(dynamics)
    rest = dynamics.state_names[2:]
    values = tuple(cast("Any", given)) if isinstance(given, list | tuple | np.ndarray) else None
    if values == ():
        return (0.0,) * len(rest)
    if values is None or len(values) != len(rest) or not _are_finite(values):
        raise InputError(
            f"has start_rest = {given!r}, should have the length {len(rest)} and finite numbers",
            key=Robot.at,
            remedy=f"start_rest is the initial state of a {dynamics.kind} without x and y",
        )
    return tuple(float(value) for value in values)


def _are_finite(values: tuple[Any, ...]) -> bool:
    return all(isinstance(one, int | float | np.number) for one in values) and bool(
        np.isfinite(values).all()
    )


def _require_dynamics(given: object) -> None:
    """Raise an error if an object lacks attributes or methods of dynamics."""
    members = (*Dynamics.__annotations__, *vars(Dynamics))
    named = [name for name in members if not name.startswith("_")]
    # A subclass of the protocol inherits its empty methods.
    missing = [
        name
        for name in named
        if isinstance(given, str | type)
        or not hasattr(given, name)
        or (name in NO_DEFAULT and getattr(type(given), name) is getattr(Dynamics, name))
    ]
    if len(missing) == len(named):
        raise InputError(
            f"is {given!r}, which does not define dynamics",
            key="robots[].dynamics",
            remedy="give planopt.problems.DoubleIntegrator(...), Unicycle(...), "
            "planopt.extend.CasadiMap(...) or your own class; leave it out for a single "
            "integrator",
        )
    if missing:
        raise InputError(
            f"the class {class_name(given)} does not define {listed(missing)}",
            key="robots[].dynamics",
            remedy="define all members of planopt.extend.Dynamics, or use planopt.extend.CasadiMap",
        )
