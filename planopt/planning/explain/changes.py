"""Changes of single keys that an explanation proposes, and the solves that confirm them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time
from typing import Literal

from planopt.planning.explanation import Relaxation
from planopt.planning.plan import Plan, Verdict
from planopt.problems.problem import Problem

Missed = Literal["connection", "separation", "moving"]
"""Violated requirement: connection, separation of robots, or clearance of moving obstacles."""

DIGITS = 5
"""Significant digits of a proposed value."""

EXPLAINED_S = 6.0
"""Time in seconds after which an explanation starts no further solve."""

EXTRA = (1.01, 1.03, 1.1, 1.5)
"""Factors of the estimated amount that are tried, since planners keep small margins."""

SETTLING_HALVINGS = 40

SETTLED = 1e-3
"""Relative tolerance of the least amount."""

LEAST_P_MIN = 0.01
"""Smallest probability of connection that is proposed."""

MOST_DB = 200.0
"""Maximum reduction of a threshold and maximum increase of slack, in dB."""

MOST_FACTOR = 1e3
"""Maximum factor by which required data are reduced."""

MOST_OUTAGE = 1e6
"""Maximum outage that is considered, in metres or seconds."""


@dataclass(frozen=True)
class Key:
    """A key with a numeric value."""

    name: str  # Name in the problem file
    unit: str  # Empty for a probability or a count
    value: float
    limit: float  # The loosest value that is considered, above or below `value`

    @property
    def most(self) -> float:
        """Return the maximum amount by which the key may be loosened."""
        return abs(self.limit - self.value)

    def loosened(self, amount: float) -> float:
        """Return the value relaxed by `amount`, rounded in the relaxing direction."""
        down = self.limit < self.value
        value = self.value + min(amount, self.most) * (-1.0 if down else 1.0)
        value = rounded(value, DIGITS, down=down)
        return max(value, self.limit) if down else min(value, self.limit)

    def changed(self, problem: Problem, value: float) -> Problem:
        """Return a problem with the key set to another value."""
        table, name = self.name.split(".")
        if table == "planner":
            return replace(problem, planner=replace(problem.planner, step_s=value))
        if table == "constraints":
            constraints = problem.constraints
            if hasattr(constraints, name):
                return replace(problem, constraints=replace(constraints, **{name: value}))
            rule = replace(constraints.rule, **{name: value})
            return replace(problem, constraints=replace(constraints, rule=rule))
        stations = list(problem.stations)
        number = int(table.removeprefix("stations[").rstrip("]"))
        stations[number] = replace(stations[number], threshold_dbm=value)
        return replace(problem, stations=tuple(stations))

    def relaxation(
        self,
        robot: str,
        value: float | None,
        stages: tuple[int, ...] = (),
        shortfall: float | None = None,
        unit: str = "",
        *,
        verified: bool = True,
    ) -> Relaxation:
        """Return the entry that proposes a value."""
        return Relaxation(
            self.name, self.unit, self.value, stages, shortfall, unit, value, verified, robot
        )


@dataclass(frozen=True)
class Trials:
    """Solver of changed problems within the time limit of an explanation."""

    # Function that plans a changed problem for the explained robot; None without a plan
    solve: Callable[[Problem], Plan | None]
    ends_s: float  # In process time, so that other programs have no influence

    @property
    def are_over(self) -> bool:
        """Return whether the time limit is reached."""
        return process_time() >= self.ends_s

    def plan(self, changed: Problem) -> Plan | None:
        """Return the plan of a changed problem."""
        return None if self.are_over else self.solve(changed)

    def is_verified(self, changed: Problem) -> bool:
        """Return whether a changed problem has a verified plan."""
        plan = self.plan(changed)
        return plan is not None and plan.verdict is Verdict.VERIFIED

    def first(self, problem: Problem, key: Key, least: float) -> float | None:
        """Return the first value near the least loosening that has a verified plan."""
        values = dict.fromkeys(key.loosened(factor * least) for factor in EXTRA)
        return next((v for v in values if self.is_verified(key.changed(problem, v))), None)


def deadline_s() -> float:
    """Return the process time at which an explanation started now must end."""
    return process_time() + EXPLAINED_S


def rounded(value: float, digits: int, down: bool) -> float:
    """Round to a number of significant digits, down or up."""
    if value == 0.0 or not math.isfinite(value):
        return value
    unit = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits)
    found = (math.floor if down else math.ceil)(value / unit) * unit
    # Formatting yields exact decimal digits, unlike multiplication by a power of ten.
    return float(f"{found:.{digits}g}")


def least_amount(suffices: Callable[[float], bool], most: float) -> float | None:
    """Return the least sufficient amount up to `most`, by bisection; None if none suffices."""
    low, high = 0.0, most
    if not suffices(high):
        return None
    for _ in range(SETTLING_HALVINGS):
        if high - low <= SETTLED * high:
            break
        middle = 0.5 * (low + high)
        low, high = (low, middle) if suffices(middle) else (middle, high)
    return high


def constraint_key(problem: Problem, name: str, unit: str, limit: float) -> Key:
    """Return a key of ``[constraints]`` or of its rule; a missing value counts as 0."""
    constraints = problem.constraints
    owner = constraints if hasattr(constraints, name) else constraints.rule
    return Key(f"constraints.{name}", unit, float(getattr(owner, name) or 0.0), limit)


def connection_keys(problem: Problem) -> list[Key]:
    """Return the keys of a hard chance constraint on each step: p_min, thresholds, slack."""
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    return [
        constraint_key(problem, "p_min", "", LEAST_P_MIN),
        *(
            Key(f"stations[{number}].threshold_dbm", "dBm", value, value - MOST_DB)
            for number, value in enumerate(each.threshold_dbm for each in problem.stations)
        ),
        constraint_key(problem, "slack_max_db", "dB", slack_db + MOST_DB),
    ]


def violated_keys(problem: Problem, missed: Missed) -> list[Key]:
    """Return the keys that define a violated requirement."""
    if missed == "separation":
        return [constraint_key(problem, "separation_m", "m", 0.0)]
    if missed == "moving":
        return [constraint_key(problem, "clearance_m", "m", 0.0)]
    rule = problem.constraints.rule
    p_min, *thresholds, slack = connection_keys(problem)
    keys = [p_min] if p_min.value > LEAST_P_MIN else []
    keys += [
        constraint_key(problem, name, name[-1], MOST_OUTAGE)
        for name in ("outage_max_m", "outage_max_s")
        if getattr(rule, name) is not None
    ]
    if rule.data_mbit:
        keys.append(constraint_key(problem, "data_mbit", "Mbit", rule.data_mbit / MOST_FACTOR))
    # Without slack_max_db, unattainable steps are excused; slack 0 would not excuse them.
    has_slack = rule.slack_max_db is not None or not rule.by_step
    return [*keys, *thresholds, *([slack] if has_slack else [])]
