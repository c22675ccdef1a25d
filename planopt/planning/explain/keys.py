"""The keys of the problem file that say how much of a constraint is required."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from planopt.planning.explain.explanation import towards
from planopt.planning.explain.faults import Fault
from planopt.problems.problem import Problem

DIGITS = 5
"""Significant digits of a value that is proposed."""


@dataclass(frozen=True)
class Key:
    """One key with a number."""

    name: str  # As the problem file has them; the unit is empty for a probability or a count
    unit: str
    asked: float  # Its value
    limit: float  # The loosest value that is looked at; above or below `asked`
    # From the whole problem and a value to the problem with it
    changed: Callable[[Problem, float], Problem]

    @property
    def most(self) -> float:
        """The largest amount by which it is loosened."""
        return abs(self.limit - self.asked)

    def loosened(self, amount: float) -> float:
        """The value that is looser by `amount`, or by a little more: one that can be typed in."""
        down = self.limit < self.asked
        value = self.asked + min(amount, self.most) * (-1.0 if down else 1.0)
        value = towards(value, DIGITS, down=down)
        return max(value, self.limit) if down else min(value, self.limit)

    def amount_of(self, value: float) -> float:
        """Return by how much a value is looser than what is asked; negative where it is tighter."""
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


def absent_key(name: str) -> Key:
    """A moving obstacle, which is there or is not: it has no value to be loosened."""

    def changed(of: Problem, _: float) -> Problem:
        rest = tuple(each for each in of.workspace.moving if each.name != name)
        return replace(of, workspace=replace(of.workspace, moving=rest))

    return Key(f"world.moving ({name})", "", 0.0, 0.0, changed)


LEAST_P_MIN = 0.01
"""A smaller probability is no answer to who wants to be connected."""

MOST_DB = 200.0
"""No threshold is lowered, and no slack widened, by more."""

MOST_FACTOR = 1e3
"""Data are not lessened by a larger factor."""

MOST_OUTAGE = 1e6
"""No longer outage is looked at, in metres or seconds."""

MOST_MOVING = 3
"""With more moving obstacles, it is not tried which of them could go."""


def connection_keys(problem: Problem) -> list[Key]:
    """The keys that say how well each step must be connected where that is a hard bound."""
    keys = [constraint_key(problem, "p_min", "", LEAST_P_MIN)]
    for number, station in enumerate(problem.stations):
        keys.append(threshold_key(problem, number, station.threshold_dbm - MOST_DB))
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    return [*keys, rule_key(problem, "slack_max_db", "dB", slack_db + MOST_DB)]


def blamed_keys(problem: Problem, fault: Fault) -> list[Key]:
    """The keys that state a missed constraint: each is named, whether loosening it helps or not."""
    if fault.missed == "separation":
        return [constraint_key(problem, "separation_m", "m", 0.0)]
    if fault.missed == "moving":
        return [constraint_key(problem, "clearance_m", "m", 0.0)]
    rule, p_min = problem.constraints.rule, problem.constraints.p_min
    keys: list[Key] = []
    if p_min > LEAST_P_MIN:
        keys.append(constraint_key(problem, "p_min", "", LEAST_P_MIN))
    for name in ("outage_max_m", "outage_max_s"):
        if getattr(rule, name) is not None:
            keys.append(rule_key(problem, name, name[-1], MOST_OUTAGE))
    if rule.data_mbit:
        keys.append(rule_key(problem, "data_mbit", "Mbit", rule.data_mbit / MOST_FACTOR))
    # Single steps without slack may be missed where nothing keeps them: slack 0 is not the same.
    slack = rule.slack_max_db is not None or not rule.by_step
    return [*keys, *connection_keys(problem)[1 : None if slack else -1]]


def moving_keys(problem: Problem, fault: Fault) -> list[Key]:
    """Moving obstacles that could go."""
    moving = problem.workspace.moving
    if fault.missed == "separation" or len(moving) > MOST_MOVING:
        return []
    return [absent_key(obstacle.name) for obstacle in moving]
