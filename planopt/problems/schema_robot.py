"""The table ``[[robots]]`` of a problem file: a robot, how it moves, and where from and to."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.errors import InputError
from planopt.problems.robot import Robot
from planopt.problems.tables import Name, Pair, Table
from planopt.robots.double_integrator import DoubleIntegrator
from planopt.robots.dynamics import Dynamics
from planopt.robots.unicycle import Unicycle

DynamicsName = Literal["single_integrator", "double_integrator", "unicycle"]

KEYS: dict[DynamicsName, tuple[str, ...]] = {
    "single_integrator": (),
    "double_integrator": ("acceleration_max_m_s2", "start_velocity_m_s"),
    "unicycle": ("turn_rate_max_rad_s", "speed_min_m_s", "start_heading_rad"),
}
"""The keys that go only with some dynamics."""

NEEDED: dict[DynamicsName, str | None] = {
    "single_integrator": None,
    "double_integrator": "acceleration_max_m_s2",
    "unicycle": "turn_rate_max_rad_s",
}
"""The key that each cannot do without."""

LEAST_LIMIT = 1e-6
"""In m/s^2 or rad/s: solvers divide by the square of it."""


class RobotTable(Table):
    """``[[robots]]``: one robot, how it moves, and where it must go."""

    name: Name = Field(default=Robot.name, description="What outputs call it.")
    start_m: Pair = Field(description="Start [x, y] in metres.")
    start_spread_m: float = Field(
        default=Robot.start_spread_m,
        ge=0,
        le=1e6,
        description="It starts at a place within so many metres of start_m, drawn with the random "
        "seed; not for the task reach.",
    )
    goal_m: Pair | None = Field(
        default=None,
        description="Goal [x, y] in metres, for the task reach and terms of kind goal.",
    )
    weights: list[Annotated[float, Field(ge=0, le=1e9)]] | None = Field(
        default=None,
        min_length=1,
        description="For tasks other than reach: weight of each of objective.terms for this robot, "
        "in their order, in place of their own. A term of weight 0 is none of its terms.",
    )
    speed_max_m_s: float = Field(gt=0, le=1000, description="Largest speed in m/s.")
    dynamics: DynamicsName = Field(
        default="single_integrator",
        description="How it moves: single_integrator (turns and stops at will), double_integrator "
        "(bounded acceleration) or unicycle (drives where it faces).",
    )
    acceleration_max_m_s2: float | None = Field(
        default=None, gt=0, le=1e4, description="Largest acceleration of a double integrator."
    )
    start_velocity_m_s: Pair | None = Field(
        default=None,
        description="Velocity [x, y] of a double integrator at the start in m/s; 0 if absent.",
    )
    turn_rate_max_rad_s: float | None = Field(
        default=None, gt=0, le=1e3, description="Largest turn rate of a unicycle in rad/s."
    )
    speed_min_m_s: float | None = Field(
        default=None,
        ge=-1000,
        le=0,
        description="Least speed of a unicycle in m/s, below 0 if it drives backward; 0 if absent.",
    )
    start_heading_rad: Annotated[float, Field(ge=-100, le=100)] | None = Field(
        default=None,
        description="Heading of a unicycle at the start in rad, from the x axis; 0 if absent.",
    )

    @model_validator(mode="after")
    def _fits_the_dynamics(self) -> RobotTable:
        for dynamics, keys in KEYS.items():
            given = [key for key in keys if getattr(self, key) is not None]
            if given and dynamics != self.dynamics:
                raise _fault(
                    f"has {given[0]}, which goes only with dynamics {dynamics}: leave it out, or "
                    f'write dynamics = "{dynamics}"'
                )
        needed = NEEDED[self.dynamics]
        if needed is not None and getattr(self, needed) is None:
            raise _fault(
                f"has dynamics {self.dynamics}, which needs {needed}: write {needed} = 1.0"
            )
        if needed is not None and getattr(self, needed) < LEAST_LIMIT:
            raise _fault(
                f"has {needed} below {LEAST_LIMIT:g}, with which it hardly moves: give a larger "
                "one, such as 1.0"
            )
        if self.start_velocity_m_s is not None:
            vx, vy = self.start_velocity_m_s
            if vx * vx + vy * vy > self.speed_max_m_s**2:
                raise _fault(
                    "has a start_velocity_m_s that is faster than speed_max_m_s: lessen it, or "
                    "raise speed_max_m_s"
                )
        return self

    @property
    def robot(self) -> Robot:
        """The plain robot."""
        return Robot(
            name=self.name,
            start_m=self.start_m,
            goal_m=self.goal_m,
            speed_max_m_s=self.speed_max_m_s,
            dynamics=self._dynamics(),
            start_rest=self._start_rest(),
            start_spread_m=self.start_spread_m,
            weights=tuple(self.weights or ()),
        )

    def _dynamics(self) -> Dynamics | None:
        if self.dynamics == "double_integrator":
            return DoubleIntegrator(self.speed_max_m_s, self.acceleration_max_m_s2 or 0.0)
        if self.dynamics == "unicycle":
            return Unicycle(
                self.speed_max_m_s, self.turn_rate_max_rad_s or 0.0, self.speed_min_m_s or 0.0
            )
        return None

    def _start_rest(self) -> tuple[float, ...]:
        match self.dynamics:
            case "single_integrator":
                return ()
            case "double_integrator":
                return self.start_velocity_m_s or (0.0, 0.0)
            case "unicycle":
                return (self.start_heading_rad or 0.0,)


def robot_table(robot: Robot) -> dict[str, Any]:
    """The keys of the table that `robot` is from, None where it has none."""
    table: dict[str, Any] = {
        "name": robot.name,
        "start_m": robot.start_m,
        "start_spread_m": robot.start_spread_m or None,
        "goal_m": robot.goal_m,
        "speed_max_m_s": robot.speed_max_m_s,
        "weights": robot.weights or None,
    }
    match robot.dynamics:
        case None:
            return table
        case DoubleIntegrator(acceleration_max_m_s2=largest):
            own = {"acceleration_max_m_s2": largest, "start_velocity_m_s": robot.start_rest}
        case Unicycle(turn_rate_max_rad_s=largest, speed_min_m_s=least):
            own = {
                "turn_rate_max_rad_s": largest,
                "speed_min_m_s": least,
                "start_heading_rad": robot.start_rest[0],
            }
        case _:
            raise InputError(
                f"{robot.dynamics.kind} is from Python and cannot be saved",
                key="robots.dynamics",
                remedy="use the plans and runs in Python",
            )
    return {**table, "dynamics": robot.dynamics.kind, **own}


def _fault(words: str) -> PydanticCustomError:
    return PydanticCustomError("one_of", "{words}", {"words": words})
