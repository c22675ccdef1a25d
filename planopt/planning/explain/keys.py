"""Which keys of the problem file bear on what a plan misses."""

from __future__ import annotations

import math

from planopt.planning.explain.case import Case
from planopt.planning.explain.fault import Fault, met_nowhere
from planopt.planning.explain.key import (
    Key,
    absent_key,
    constraint_key,
    drive_key,
    horizon_key,
    rule_key,
    threshold_key,
)
from planopt.problems.problem import Problem
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.robots.double_integrator import DoubleIntegrator
from planopt.robots.unicycle import Unicycle

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
    match problem.constraints.rule.connectivity:
        case "joint" | "outage":
            return [horizon_key(problem, MIN_HORIZON)] if asked > MIN_HORIZON else []
        case "average" | "data":
            return [horizon_key(problem, longest)] if asked < longest else []
        case _:
            return [horizon_key(problem, longest)] if met_nowhere(case) and asked < longest else []


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
