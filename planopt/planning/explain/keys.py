"""The constraints that a plan misses, and the keys of the problem file that bear on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.planning.explain.explanation import Case, towards
from planopt.planning.explain.possible import best_margin_db
from planopt.planning.history import BEGINNING
from planopt.planning.proof.rules.each_step import counted_steps
from planopt.planning.proof.rules.rule import rule_of
from planopt.planning.proof.single_steps import is_priced
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, MARGIN_TOLERANCE_DB
from planopt.planning.worth.rule_rows import common_level
from planopt.problems.problem import Problem
from planopt.problems.robot import Robot
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.robots.double_integrator import DoubleIntegrator
from planopt.robots.drive import braked_motion
from planopt.robots.unicycle import Unicycle
from planopt.world.least_distance import step_distances_m

Missed = Literal["connection", "separation", "moving"]


@dataclass(frozen=True)
class Fault:
    """A constraint that a plan does not keep."""

    missed: Missed  # The connection, the distance of other robots, or that of moving obstacles
    stages: tuple[int, ...]  # Steps (1 is the first) that it is about
    shortfall: float  # By how much it is missed; the unit is empty for a probability
    unit: str


def faults_of(case: Case) -> tuple[Fault, ...]:
    """Everything that the plan misses; empty where it is only the motion."""
    connection = _connection(case)
    found = [] if connection is None else [connection]
    return (*found, *_distances(case))


def met_nowhere(case: Case) -> bool:
    """Return whether single steps are asked for, may be missed, and all are."""
    rule = case.problem.constraints.rule
    steps = len(case.plan.positions_m) - 1
    missed = case.plan.certificate.relaxed_steps
    asked = counted_steps(case.own, BEGINNING, steps)
    return rule.by_step and rule.slack_max_db is None and 0 < len(missed) == int(asked.sum())


def _connection(case: Case) -> Fault | None:
    problem, certificate = case.own, case.plan.certificate
    rule, result = problem.constraints.rule, certificate.rule
    if not rule.by_step:
        if result is None or result.slack_db > 0.0 or not result.is_missed:
            return None
        unit = "" if result.unit == "probability" else result.unit
        return Fault(
            "connection",
            _stages(case.plan.connectivity[1:] < _level(problem, len(case.plan.positions_m) - 1)),
            result.missing,
            unit,
        )
    limit = rule.slack_max_db or 0.0
    missed = [
        (step, missing - limit)
        for step, missing in zip(certificate.relaxed_steps, certificate.relaxation_db, strict=True)
        if missing > limit + MARGIN_TOLERANCE_DB
    ]
    if not missed:
        return None
    stages = tuple(step for step, _ in missed)
    short_db = max(missing for _, missing in missed)
    if met_nowhere(case) or is_priced(problem):
        # The limit of what any plan could keep, unless that is not what is in the way.
        best_db = best_margin_db(problem, case.posteriors)
        short_db = -best_db if best_db < 0.0 else short_db
    elif rule.slack_max_db is None and max(certificate.best_margin_db) < 0.0:
        return None  # nothing within reach keeps these steps, which excuses them
    return Fault("connection", stages, short_db, "dB")


def _distances(case: Case) -> list[Fault]:
    """Distances at equal times that are not kept, of robots and of moving obstacles.

    What is not kept while robots stop after the last step counts as of the last.
    """
    discs, planned = case.moving, len(case.plan.positions_m) - 1
    motion = braked_motion(case.plan.positions_m, case.plan.drive, case.problem.planner.step_s)
    away = np.full((len(discs), planned), np.inf)
    for number in range(len(discs)):
        count = discs.counted_steps(number, motion)
        gaps = step_distances_m(motion, discs.motion(number), count)
        gaps -= discs.radius_m[number, :count] + discs.least_m[number]
        np.minimum.at(away[number], np.minimum(np.arange(count), planned - 1), gaps)
    found: list[Fault] = []
    kinds: list[tuple[Missed, NDArray[np.bool_]]] = [
        ("separation", discs.is_robot),
        ("moving", ~discs.is_robot),
    ]
    for missed, which in kinds:
        if not which.any():
            continue
        least = away[which].min(axis=0)
        if least.min() < -CLEARANCE_TOLERANCE_M:
            stages = _stages(least < -CLEARANCE_TOLERANCE_M)
            found.append(Fault(missed, stages, float(-least.min()), "m"))
    return found


LEVEL_ERROR = 1e-4
"""Differences of levels within it are of the bisection."""


def _level(problem: Problem, steps: int) -> float:
    """Return the probability that all steps of a plan would need, were they alike."""
    constraints, rule = problem.constraints, rule_of(problem, np.ones(steps))
    if constraints.rule.kind.holds_steps:
        return constraints.p_min
    return common_level(rule, constraints.p_min, BEGINNING, steps)


def _stages(which: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple((np.flatnonzero(which) + 1).tolist())


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
    whole: bool = False  # Whether it counts something

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


LEAST_P_MIN = 0.01
"""A smaller probability is no answer to who wants to be connected."""

MOST_DB = 200.0
"""No threshold is lowered, and no slack widened, by more."""

MOST_FACTOR = 1e3
"""Data, rates and times are not changed by a larger factor."""

MOST_MOVING = 10
"""With more moving obstacles, it is not tried which of them could go."""

LONGEST_HORIZON = 100
"""Longer ones are not tried, unless what is asked is longer."""


def connection_keys(problem: Problem) -> list[Key]:
    """The keys that say how well each step must be connected where that is a hard bound."""
    keys = [constraint_key(problem, "p_min", "", LEAST_P_MIN)]
    for number, station in enumerate(problem.stations):
        keys.append(threshold_key(problem, number, station.threshold_dbm - MOST_DB))
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    return [*keys, rule_key(problem, "slack_max_db", "dB", slack_db + MOST_DB)]


def blamed_keys(case: Case, fault: Fault) -> list[Key]:
    """The keys that say what is missed: each is named, whether loosening it helps or not."""
    problem = case.problem
    if fault.missed == "separation":
        return [constraint_key(problem, "separation_m", "m", 0.0)]
    if fault.missed == "moving":
        return [constraint_key(problem, "clearance_m", "m", 0.0)]
    rule, p_min = problem.constraints.rule, problem.constraints.p_min
    keys: list[Key] = []
    if p_min > LEAST_P_MIN:
        keys.append(constraint_key(problem, "p_min", "", LEAST_P_MIN))
    steps = case.own.planner.horizon
    if rule.outage_max_m is not None:
        all_m = steps * case.own.step_length_m
        keys.append(rule_key(problem, "outage_max_m", "m", rule.outage_max_m + all_m))
    if rule.outage_max_s is not None:
        all_s = steps * problem.planner.step_s
        keys.append(rule_key(problem, "outage_max_s", "s", rule.outage_max_s + all_s))
    if rule.data_mbit and rule.deadline_s and rule.rate_mbit_s:
        keys += [
            rule_key(problem, "data_mbit", "Mbit", rule.data_mbit / MOST_FACTOR),
            rule_key(problem, "deadline_s", "s", rule.deadline_s * MOST_FACTOR),
            rule_key(problem, "rate_mbit_s", "Mbit/s", rule.rate_mbit_s * MOST_FACTOR),
        ]
    for number, station in enumerate(problem.stations):
        keys.append(threshold_key(problem, number, station.threshold_dbm - MOST_DB))
    # Single steps without the key may be missed as well where nothing keeps them: not the same.
    if rule.slack_max_db is not None or not rule.by_step:
        keys.append(rule_key(problem, "slack_max_db", "dB", (rule.slack_max_db or 0.0) + MOST_DB))
    return keys


def other_keys(case: Case, fault: Fault) -> list[Key]:
    """Keys that may stand in the way: each is named where loosening it is found to help."""
    keys = _drive_keys(case)
    problem = case.problem
    if fault.missed != "connection":
        return keys
    keys = [*_horizon_keys(case), *keys]
    constraints, workspace = problem.constraints, problem.workspace
    if constraints.clearance_m > 0.0 and (workspace.obstacles or workspace.moving):
        keys.append(constraint_key(problem, "clearance_m", "m", 0.0))
    if constraints.separation_m > 0.0 and len(problem.robots) > 1:
        keys.append(constraint_key(problem, "separation_m", "m", 0.0))
    return keys


def moving_keys(case: Case, fault: Fault) -> list[Key]:
    """Moving obstacles that could go."""
    moving = case.problem.workspace.moving
    if fault.missed == "separation" or len(moving) > MOST_MOVING:
        return []
    return [absent_key(obstacle.name) for obstacle in moving]


def _horizon_keys(case: Case) -> list[Key]:
    """A longer horizon comes farther; of a shorter one less is asked."""
    problem = case.problem
    asked = problem.planner.horizon
    longest = min(max(_steps_across(case.own), 2 * asked), MAX_HORIZON, max(asked, LONGEST_HORIZON))
    rule = problem.constraints.rule
    if not rule.by_step and (
        rule.kind.holds_steps or _level(case.own, asked + 1) > _level(case.own, asked) + LEVEL_ERROR
    ):
        return [horizon_key(problem, MIN_HORIZON)] if asked > MIN_HORIZON else []
    helps = met_nowhere(case) or not rule.by_step
    return [horizon_key(problem, longest)] if helps and asked < longest else []


def _drive_keys(case: Case) -> list[Key]:
    """Limits of how the robot moves, up to what takes it across the workspace in the horizon.

    Within a step it then reverses its speed, or turns right round.
    """
    problem, own = case.problem, case.own
    robot, planner = own.robots[0], own.planner
    across = robot.speed_max_m_s * _steps_across(own) / planner.horizon
    keys: list[Key] = []
    if across > robot.speed_max_m_s and isinstance(
        robot.dynamics, DoubleIntegrator | Unicycle | None
    ):
        keys.append(drive_key(problem, case.number, "speed_max_m_s", "m/s", across))
    if isinstance(robot.dynamics, DoubleIntegrator):
        most = 2.0 * robot.speed_max_m_s / planner.step_s
        if most > robot.dynamics.acceleration_max_m_s2:
            keys.append(drive_key(problem, case.number, "acceleration_max_m_s2", "m/s^2", most))
    if isinstance(robot.dynamics, Unicycle):
        most = math.pi / planner.step_s
        if most > robot.dynamics.turn_rate_max_rad_s:
            keys.append(drive_key(problem, case.number, "turn_rate_max_rad_s", "rad/s", most))
    return keys


def _steps_across(problem: Problem) -> int:
    """Steps from corner to corner of the workspace, by air."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    return math.ceil(math.hypot(x_max - x_min, y_max - y_min) / problem.step_length_m)
