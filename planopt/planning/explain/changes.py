"""Violated constraints of a plan, and the smallest change of each key that would satisfy them.

The change is estimated on existing paths and confirmed by solving the changed problem.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import process_time
from typing import Literal

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.kriging import Prediction, connection_probability
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.certificate import Relaxation, required_margins_db
from planopt.planning.plan import BEGINNING, Plan, Verdict
from planopt.planning.proof.rule import (
    PathCase,
    VerifierContext,
    certified_prediction,
    connectivity_law,
    rule_of,
    search_power,
    search_prediction,
    stations_law,
    whole_plan_result,
)
from planopt.planning.proof.searches import best_margins_by_step, build_goal_grid
from planopt.planning.proof.verify import is_priced
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, MARGIN_TOLERANCE_DB
from planopt.planning.values.objective_value import common_level
from planopt.problems.problem import Problem, may_reach_from, problem_of_robot
from planopt.robots.dynamics import braked_motion
from planopt.world.clearance import index_obstacles
from planopt.world.motion import MovingDiscs, step_distances_m
from planopt.world.workspace import MovingObstacle, Obstacle

Missed = Literal["connection", "separation", "moving"]
"""Violated requirement: connection, separation of robots, or clearance from moving obstacles."""
DIGITS = 5  # Significant digits of a proposed value
EXPLAINED_S = 6.0  # Time in seconds after which an explanation starts no further solve
EXTRA = (1.01, 1.03, 1.1, 1.5)
"""Factors on the estimated amount, tried in turn because planners keep small margins."""
SETTLING_HALVINGS, SETTLED, BISECTED_DIGITS = 40, 1e-3, 12
"""Maximum number of bisections of an amount, its relative tolerance; digits of bisected values."""
LEAST_P_MIN = 0.01  # Smallest value proposed for p_min
MOST_DB = 200.0  # Maximum reduction of a threshold and maximum increase of slack, in dB
MOST_FACTOR = 1e3  # Maximum factor by which required data are reduced
MOST_OUTAGE = 1e6  # Maximum outage that is considered, in metres or seconds


@dataclass(frozen=True)
class Key:
    """Problem file key with a numeric value that may be loosened."""

    name: str  # Name in the problem file
    unit: str  # Empty for probabilities and counts
    value: float  # NaN for an obstacle
    limit: float  # Loosest value to consider; may be larger or smaller than `value`

    @property
    def most(self) -> float:
        """Return the maximum amount by which the key may be loosened."""
        return abs(self.limit - self.value)

    def loosened(self, amount: float) -> float:
        """Return the value loosened by `amount`, rounded in the loosening direction."""
        down = self.limit < self.value
        value = self.value + min(amount, self.most) * (-1.0 if down else 1.0)
        value = rounded(value, DIGITS, down=down)
        return max(value, self.limit) if down else min(value, self.limit)

    def changed(self, problem: Problem, value: float) -> Problem:
        """Return the problem with this key set to `value`."""
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
        stages: tuple[int, ...],
        shortfall: float | None,
        unit: str,
        relaxed_value: float | None,
        *,
        verified: bool = True,
    ) -> Relaxation:
        """Return a relaxation to `relaxed_value`; None stands for a removed obstacle or limit."""
        value = None if math.isnan(self.value) else self.value
        return Relaxation(
            self.name, self.unit, value, stages, shortfall, unit, relaxed_value, verified, robot
        )


@dataclass(frozen=True)
class Trials:
    """Trial solves of changed problems within the time limit of an explanation."""

    # Returns the explained robot's plan in a changed problem; None without a plan
    solve: Callable[[Problem], Plan | None]
    ends_s: float  # Process time, which other programs do not affect

    @property
    def are_over(self) -> bool:
        """Return whether the time limit of the explanation is reached."""
        return process_time() >= self.ends_s

    def plan(self, changed: Problem) -> Plan | None:
        """Return the explained robot's plan in a changed problem; None if there is none."""
        return None if self.are_over else self.solve(changed)

    def is_verified(self, changed: Problem) -> bool:
        """Return whether a changed problem has a verified plan."""
        plan = self.plan(changed)
        return plan is not None and plan.verdict is Verdict.VERIFIED

    def first(self, problem: Problem, key: Key, least: float) -> float | None:
        """Return a value that is loosened by about `least` and gives a verified plan, or None."""
        values = dict.fromkeys(key.loosened(factor * least) for factor in EXTRA)
        return next((v for v in values if self.is_verified(key.changed(problem, v))), None)


def rounded(value: float, digits: int, down: bool) -> float:
    """Return `value` rounded down or up to a number of significant digits."""
    if value == 0.0 or not math.isfinite(value):
        return value
    unit = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits)
    found = (math.floor if down else math.ceil)(value / unit) * unit
    # Formatting yields exact decimal digits, unlike multiplication by a power of ten.
    return float(f"{found:.{digits}g}")


def bisected(
    suffices: Callable[[float], bool], least: float, most: float, count: int, settled: float = 0.0
) -> float:
    """Return the sufficient value nearest to `least`, by bisection from a sufficient `most`."""
    # `most` must suffice; it may be smaller than `least`. At most `count` halvings are made.
    for _ in range(count):
        if abs(most - least) <= settled * most:  # Relative tolerance
            break
        middle = rounded(0.5 * (least + most), BISECTED_DIGITS, down=most < least)
        least, most = (least, middle) if suffices(middle) else (middle, most)
    return most


def without(
    problem: Problem, kind: Literal["obstacles", "moving"], obstacle: Obstacle | MovingObstacle
) -> tuple[Key, Problem]:
    """Return the key of an obstacle, and the problem without this obstacle."""
    rest = tuple(each for each in getattr(problem.workspace, kind) if each is not obstacle)
    changed = replace(problem, workspace=replace(problem.workspace, **{kind: rest}))
    return Key(f"world.{kind} ({obstacle.name})", "", math.nan, 0.0), changed


def constraint_key(problem: Problem, name: str, unit: str, limit: float) -> Key:
    """Return a key of ``[constraints]`` or of the connectivity rule, with 0 for no value."""
    constraints = problem.constraints
    owner = constraints if hasattr(constraints, name) else constraints.rule
    return Key(f"constraints.{name}", unit, float(getattr(owner, name) or 0.0), limit)


def connection_keys(problem: Problem) -> list[Key]:
    """Return the keys of a hard chance constraint per step: p_min, thresholds and slack."""
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
    """Return the problem's keys that define the violated requirement `missed`."""
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


MOST_MOVING = 3  # Number of moving obstacles up to which the removal of each is tried
SLACK_PRICE = 1e5  # Price per dB of slack that dominates the objective


@dataclass(frozen=True, eq=False)
class Case:
    """Plan of one robot at the start of a run, to be explained, with the channel belief used."""

    problem: Problem  # Problem with all robots
    number: int  # Number of the robot
    posteriors: Sequence[ChannelPosterior]  # Channel posterior per station, used by the plan
    plan: Plan
    moving: MovingDiscs  # Moving obstacles, and other robots' plans if a separation is required

    @property
    def own(self) -> Problem:
        """Return the problem restricted to this robot."""
        return problem_of_robot(self.problem, self.number)


@dataclass(frozen=True)
class Fault:
    """Violation of one constraint by a plan."""

    missed: Missed
    stages: tuple[int, ...]  # Violating steps, counted from 1
    shortfall: float  # Amount of the violation
    unit: str  # Unit of the shortfall; empty for a probability

    @classmethod
    def at(cls, missed: Missed, steps: Mask, shortfall: float, unit: str) -> Fault:
        """Return a fault at the steps that the mask `steps` (N,) marks."""
        return cls(missed, tuple((np.flatnonzero(steps) + 1).tolist()), shortfall, unit)


def _met_nowhere(case: Case) -> bool:
    """Return whether all constrained steps violate p_min, and slack is not allowed."""
    rule = case.problem.constraints.rule
    steps = len(case.plan.positions_m) - 1
    missed = case.plan.certificate.relaxed_steps
    counted = int(rule_of(case.own).counted(BEGINNING, steps).sum())
    return rule.by_step and rule.slack_max_db is None and 0 < len(missed) == counted


def _connection(case: Case) -> Fault | None:
    """Return the violation of the connectivity rule; None if it is satisfied or excused."""
    problem, certificate = case.own, case.plan.certificate
    rule, result = problem.constraints.rule, certificate.rule
    if not rule.by_step:
        if result is None or result.slack_db > 0.0 or not result.is_missed:
            return None
        unit, steps = "" if result.unit == "probability" else result.unit, len(case.plan.t_s) - 1
        level = problem.constraints.p_min
        if not rule.kind.holds_steps:
            # Required probability per step if all steps were equal.
            level = common_level(rule_of(problem, np.ones(steps)), level, BEGINNING, steps)
        return Fault.at("connection", case.plan.connectivity[1:] < level, result.missing, unit)
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
    if _met_nowhere(case) or is_priced(problem):
        # If no reachable position has this probability, the shortfall of the best one is reported.
        best_db = _best_score(problem, case.posteriors, partial(required_margins_db, problem))
        short_db = -best_db if best_db < 0.0 else short_db
    elif rule.slack_max_db is None and max(certificate.best_margin_db) < 0.0:
        return None  # excused, as no reachable position satisfies them
    return Fault("connection", stages, short_db, "dB")


def _distances(case: Case) -> list[Fault]:
    """Return violations of the separation from other robots and moving obstacles."""
    # Violations while a robot brakes after the last step count towards the last step.
    discs, planned = case.moving, len(case.plan.positions_m) - 1
    motion = braked_motion(case.plan.positions_m, case.plan.drive, case.problem.planner.step_s)
    away = np.full((len(discs), planned), np.inf)
    for number in range(len(discs)):
        count = discs.counted_steps(number, motion)
        gaps = step_distances_m(motion, discs.motion(number), count)
        gaps -= discs.radius_m[number, :count] + discs.least_m[number]
        np.minimum.at(away[number], np.minimum(np.arange(count), planned - 1), gaps)
    found: list[Fault] = []
    kinds: tuple[Missed, Missed] = ("separation", "moving")
    for missed, which in zip(kinds, (discs.is_robot, ~discs.is_robot), strict=True):
        least = away[which].min(axis=0, initial=np.inf)
        if least.min() < -CLEARANCE_TOLERANCE_M:
            found.append(Fault.at(missed, least < -CLEARANCE_TOLERANCE_M, -float(least.min()), "m"))
    return found


def _best_score(
    problem: Problem, posteriors: Sequence[ChannelPosterior], score: Callable[[Prediction], Floats]
) -> float:
    """Return the largest connectivity score that a constrained step can attain."""
    # If steps may violate p_min at a price, the whole workspace counts as reachable.
    law, index = connectivity_law(problem, posteriors), index_obstacles(problem.workspace)
    if is_priced(problem):
        places = build_goal_grid(problem, index).nodes_m
        return float(score(search_prediction(law, places)).max())
    state, horizon = problem.robots[0].start_state, problem.planner.horizon
    best = best_margins_by_step(
        index,
        problem.workspace.bounds_m,
        lambda places: score(law.predicted(places, search_power)),
        state[:2],
        problem.step_length_m,
        np.arange(1, horizon + 1),
        problem.constraints.clearance_m,
        may_reach_from(problem, state),
    )
    return float(np.array(best)[rule_of(problem).counted(BEGINNING, horizon)].max())


def explain_violated(case: Case, trials: Trials) -> tuple[Relaxation, ...]:
    """Return changes of keys, each sufficient by itself to satisfy all constraints of a plan."""
    found: dict[str, Relaxation] = {}
    problem, connection = case.problem, _connection(case)
    for fault in (*([] if connection is None else [connection]), *_distances(case)):
        known = case.plan.robot, fault.stages, fault.shortfall, fault.unit
        cases = [case, *_elastic(case, trials)] if fault.missed == "connection" else [case]
        for key in violated_keys(problem, fault.missed):
            least = _lacking(fault, key, cases)
            value = trials.first(problem, key, least)
            if value is not None or least < key.most:
                proposed = key.loosened(least) if value is None else value
                entry = key.relaxation(*known, proposed, verified=value is not None)
                found.setdefault(key.name, entry)
        moving = problem.workspace.moving if fault.missed != "separation" else ()
        for obstacle in moving if len(moving) <= MOST_MOVING else ():
            removed, changed = without(problem, "moving", obstacle)
            if trials.is_verified(changed):
                found.setdefault(removed.name, removed.relaxation(*known, None))
    return tuple(found.values())


def _elastic(case: Case, trials: Trials) -> list[Case]:
    """Return the case replanned with priced slack, as a list; empty if there is no plan."""
    problem, rule = case.problem, case.problem.constraints.rule
    if problem.has_goal or (rule.by_step and rule.slack_max_db is None):
        return []
    elastic = replace(rule, slack_max_db=MOST_DB, slack_price=SLACK_PRICE)
    constraints = replace(problem.constraints, rule=elastic)
    plan = trials.plan(replace(problem, constraints=constraints))
    return [] if plan is None else [replace(case, plan=plan)]


def _lacking(fault: Fault, key: Key, cases: list[Case]) -> float:
    """Return an estimate of the amount by which a key must be loosened to repair a fault."""
    case = cases[0]
    if fault.missed != "connection":
        return min(fault.shortfall, key.most)
    if _met_nowhere(case):
        least, own = fault.shortfall, case.own
        if key.name == "constraints.p_min":
            threshold = own.stations[0].threshold_dbm
            least = -_best_score(
                own,
                case.posteriors,
                lambda power: (
                    connection_probability(power.mean_db, power.deviation_db, threshold) - key.value
                ),
            )
        if least > 0.0:
            return min(least, key.most)
    return min(
        (
            bisected(
                lambda amount, each=each: _is_kept(each, key, amount),
                *(0.0, key.most, SETTLING_HALVINGS, SETTLED),
            )
            for each in cases
            if _is_kept(each, key, key.most)
        ),
        default=key.most,
    )


def _is_kept(case: Case, key: Key, amount: float) -> bool:
    """Return whether the existing path satisfies its rule if `key` is loosened by `amount`."""
    changed = key.changed(case.problem, key.loosened(amount))
    problem, plan = problem_of_robot(changed, case.number), case.plan
    rule = problem.constraints.rule
    power = Prediction(plan.mean_dbm[1:], plan.deviation_db[1:])
    if len(case.posteriors) > 1:
        # The distribution that combines several stations depends on thresholds and on p_min.
        law = stations_law(problem, case.posteriors)
        power, _ = certified_prediction(law, plan.positions_m[1:])
    if not rule.by_step:
        index, start = index_obstacles(problem.workspace), plan.positions_m[0]
        context = VerifierContext(problem, index, tuple(case.posteriors), start)
        result = whole_plan_result(PathCase(context, plan.positions_m, power))
        return result.slack_db > 0.0 or not result.is_missed
    margins = required_margins_db(problem, power) + (rule.slack_max_db or 0.0)
    kept = margins[[step - 1 for step in plan.certificate.relaxed_steps]] >= -MARGIN_TOLERANCE_DB
    return bool(kept.any() if _met_nowhere(case) else kept.all())
