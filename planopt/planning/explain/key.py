"""A key of the problem file that may be loosened, and the problem with another value of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from planopt.planning.explain.explanation import towards
from planopt.problems.problem import Problem
from planopt.problems.robot import Robot

DIGITS = 5
"""Significant digits of a value that is proposed."""


@dataclass(frozen=True)
class Key:
    """One key with a number.

    Attributes
    ----------
    name, unit
        As the problem file has them; the unit is empty for a probability or a count.
    asked
        Its value.
    limit
        The loosest value that is looked at; above or below `asked`.
    changed
        From the whole problem and a value to the problem with it.
    whole
        Whether it counts something.
    """

    name: str
    unit: str
    asked: float
    limit: float
    changed: Callable[[Problem, float], Problem]
    whole: bool = False

    @property
    def most(self) -> float:
        """The largest amount by which it is loosened."""
        return abs(self.limit - self.asked)

    def loosened(self, amount: float) -> float:
        """The value that is looser by `amount`, or by a little more: one that can be typed in."""
        down = self.limit < self.asked
        value = self.asked + min(amount, self.most) * (-1.0 if down else 1.0)
        if self.whole:
            return float(-(-value // 1.0)) if not down else float(value // 1.0)
        value = towards(value, DIGITS, down=down)
        return max(value, self.limit) if down else min(value, self.limit)

    def amount_of(self, value: float) -> float:
        """By how much a value is looser than what is asked; negative where it is tighter."""
        return self.asked - value if self.limit < self.asked else value - self.asked


def constraint_key(problem: Problem, name: str, unit: str, limit: float) -> Key:
    """A key of ``[constraints]`` that every problem has, such as ``p_min``."""
    asked = float(getattr(problem.constraints, name))

    def changed(of: Problem, value: float) -> Problem:
        return replace(of, constraints=replace(of.constraints, **{name: value}))

    return Key(f"constraints.{name}", unit, asked, limit, changed)


def rule_key(problem: Problem, name: str, unit: str, limit: float) -> Key:
    """A key of ``[constraints]`` that belongs to the rule of connectivity; absent is 0."""
    asked = float(getattr(problem.constraints.rule, name) or 0.0)

    def changed(of: Problem, value: float) -> Problem:
        rule = replace(of.constraints.rule, **{name: value})
        return replace(of, constraints=replace(of.constraints, rule=rule))

    return Key(f"constraints.{name}", unit, asked, limit, changed)


def threshold_key(problem: Problem, number: int, limit: float) -> Key:
    """The threshold of a station."""

    def changed(of: Problem, value: float) -> Problem:
        stations = list(of.stations)
        stations[number] = replace(stations[number], threshold_dbm=value)
        return replace(of, stations=tuple(stations))

    asked = problem.stations[number].threshold_dbm
    return Key(f"stations[{number}].threshold_dbm", "dBm", asked, limit, changed)


def horizon_key(problem: Problem, limit: int) -> Key:
    """The horizon, to be made longer or shorter."""

    def changed(of: Problem, value: float) -> Problem:
        return replace(of, planner=replace(of.planner, horizon=round(value)))

    asked = problem.planner.horizon
    return Key("planner.horizon", "", asked, limit, changed, whole=True)


def absent_key(name: str) -> Key:
    """A moving obstacle, which is there or is not: it has no value to be loosened."""

    def changed(of: Problem, _: float) -> Problem:
        rest = tuple(each for each in of.workspace.moving if each.name != name)
        return replace(of, workspace=replace(of.workspace, moving=rest))

    return Key(f"world.moving ({name})", "", 0.0, 0.0, changed)


DriveLimit = Literal["speed_max_m_s", "acceleration_max_m_s2", "turn_rate_max_rad_s"]


def drive_key(problem: Problem, number: int, name: DriveLimit, unit: str, limit: float) -> Key:
    """A limit of how a robot moves, which it and its dynamics may both have."""

    def changed(of: Problem, value: float) -> Problem:
        robots = list(of.robots)
        robots[number] = _with_limit(robots[number], name, value)
        return replace(of, robots=tuple(robots))

    robot = problem.robots[number]
    asked = float(getattr(robot if name == "speed_max_m_s" else robot.dynamics, name))
    return Key(f"robots[{number}].{name}", unit, asked, limit, changed)


def _with_limit(robot: Robot, name: DriveLimit, value: float) -> Robot:
    if name == "speed_max_m_s":
        robot = replace(robot, speed_max_m_s=value)
    if robot.dynamics is None:
        return robot
    # The dynamics of problem files are data.
    return replace(robot, dynamics=replace(robot.dynamics, **{name: value}))  # type: ignore[type-var]
