"""Violated constraints of a plan, and the least change of each key that would satisfy them.

The change is estimated on existing paths without solving, and confirmed by solving again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.explain.changes import (
    MOST_DB,
    Key,
    Missed,
    Trials,
    least_amount,
    violated_keys,
)
from planopt.planning.explanation import Relaxation
from planopt.planning.history import BEGINNING
from planopt.planning.plan import Plan
from planopt.planning.proof.context import (
    VerifierContext,
    certified_prediction,
    connectivity_law,
    search_prediction,
    stations_law,
)
from planopt.planning.proof.rule import PathCase, rule_of, whole_plan_result
from planopt.planning.proof.searches import best_margins_by_step, build_goal_grid, may_reach_from
from planopt.planning.proof.verify import is_priced
from planopt.planning.tolerances import (
    CLEARANCE_TOLERANCE_M,
    MARGIN_TOLERANCE_DB,
    margins_asked_db,
)
from planopt.planning.values.rule_rows import common_level
from planopt.problems.problem import Problem, problem_of_robot
from planopt.robots.dynamics import braked_motion
from planopt.world.clearance import index_obstacles
from planopt.world.motion import step_distances_m
from planopt.world.moving_discs import MovingDiscs

MOST_MOVING = 3
"""Maximum number of moving obstacles up to which removing each one is tried."""

SLACK_PRICE = 1e5
"""Price per dB of slack that dominates the objective."""


@dataclass(frozen=True, eq=False)
class Case:
    """One robot's plan from the start of a run."""

    problem: Problem  # Problem with all robots
    number: int  # Number of the robot
    posteriors: Sequence[ChannelPosterior]  # Belief that the plan is based on, by station
    plan: Plan
    # Moving obstacles, and the plans of other robots if a separation is required
    moving: MovingDiscs

    @property
    def own(self) -> Problem:
        """Return the problem restricted to this robot."""
        return problem_of_robot(self.problem, self.number)


@dataclass(frozen=True)
class Fault:
    """A constraint that a plan violates."""

    missed: Missed
    stages: tuple[int, ...]  # Violating steps, counted from 1
    shortfall: float  # Amount of the violation
    unit: str  # Unit of the shortfall; empty for a probability


def _met_nowhere(case: Case) -> bool:
    """Return whether every counted step misses a p_min that applies per step without slack."""
    rule = case.problem.constraints.rule
    steps = len(case.plan.positions_m) - 1
    missed = case.plan.certificate.relaxed_steps
    counted = int(rule_of(case.own).counted(BEGINNING, steps).sum())
    return rule.by_step and rule.slack_max_db is None and 0 < len(missed) == counted


def _connection(case: Case) -> Fault | None:
    """Return the violation of the connectivity rule."""
    problem, certificate = case.own, case.plan.certificate
    rule, result = problem.constraints.rule, certificate.rule
    if not rule.by_step:
        if result is None or result.slack_db > 0.0 or not result.is_missed:
            return None
        unit, steps = "" if result.unit == "probability" else result.unit, len(case.plan.t_s) - 1
        level = problem.constraints.p_min
        if not rule.kind.holds_steps:
            # The required probability if all steps were equal.
            level = common_level(rule_of(problem, np.ones(steps)), level, BEGINNING, steps)
        stages = _stages(case.plan.connectivity[1:] < level)
        return Fault("connection", stages, result.missing, unit)
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
        # If even the best reachable position misses the level, its shortfall is reported.
        best_db = best_margin_db(problem, case.posteriors)
        short_db = -best_db if best_db < 0.0 else short_db
    elif rule.slack_max_db is None and max(certificate.best_margin_db) < 0.0:
        return None  # no reachable position satisfies these steps, which excuses them
    return Fault("connection", stages, short_db, "dB")


def _distances(case: Case) -> list[Fault]:
    """Return violated distances to robots and moving obstacles at equal times.

    Violations while a robot brakes after the last step count towards the last step.
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


def _stages(which: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple((np.flatnonzero(which) + 1).tolist())


def best_probability(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> float:
    """Return the largest ``p_min`` that a counted step can satisfy at a reachable position."""
    radio, p_min = problem.stations[0], problem.constraints.p_min

    def excess(power: Prediction) -> NDArray[np.float64]:
        chance = connection_probability(power.mean_db, power.deviation_db, radio.threshold_dbm)
        return chance - p_min

    return p_min + _best_score(problem, posteriors, excess)


def best_margin_db(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> float:
    """Return the largest margin in dB that a counted step can have at a reachable position."""
    return _best_score(problem, posteriors, partial(margins_asked_db, problem))


def _best_score(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    score: Callable[[Prediction], NDArray[np.float64]],
) -> float:
    """Return the largest score of a counted step at a reachable position.

    If steps may violate p_min at a price, the whole workspace counts as reachable.
    """
    law, index = connectivity_law(problem, posteriors), index_obstacles(problem.workspace)
    if is_priced(problem):
        places = build_goal_grid(problem, index).nodes_m
        return float(score(search_prediction(law, places)).max())
    state, horizon = problem.robots[0].start_state, problem.planner.horizon
    best = best_margins_by_step(
        index,
        problem.workspace.bounds_m,
        lambda places: score(search_prediction(law, places)),
        state[:2],
        problem.step_length_m,
        np.arange(1, horizon + 1),
        problem.constraints.clearance_m,
        may_reach_from(problem, state),
    )
    return float(np.array(best)[rule_of(problem).counted(BEGINNING, horizon)].max())


def explain_violated(case: Case, trials: Trials) -> tuple[Relaxation, ...]:
    """Return changes, each of which alone would satisfy all constraints."""
    found: dict[str, Relaxation] = {}
    connection = _connection(case)
    for fault in (*([] if connection is None else [connection]), *_distances(case)):
        cases = [case, *_elastic(case, trials)] if fault.missed == "connection" else [case]
        for key in violated_keys(case.problem, fault.missed):
            least = _lacking(fault, key, cases)
            value = trials.first(case.problem, key, least)
            if value is not None or least < key.most:
                proposed = key.loosened(least) if value is None else value
                entry = _entry(case, fault, key, proposed, verified=value is not None)
                found.setdefault(key.name, entry)
        moving = case.problem.workspace.moving
        for obstacle in moving if len(moving) <= MOST_MOVING else ():
            rest = tuple(each for each in moving if each is not obstacle)
            workspace = replace(case.problem.workspace, moving=rest)
            if fault.missed != "separation" and trials.is_verified(
                replace(case.problem, workspace=workspace)
            ):
                key = Key(f"world.moving ({obstacle.name})", "", 0.0, 0.0)
                gone = _entry(case, fault, key, None, verified=True)
                found.setdefault(key.name, replace(gone, value=None))
    return tuple(found.values())


def _entry(
    case: Case, fault: Fault, key: Key, value: float | None, *, verified: bool
) -> Relaxation:
    return key.relaxation(
        case.plan.robot, value, fault.stages, fault.shortfall, fault.unit, verified=verified
    )


def _elastic(case: Case, trials: Trials) -> list[Case]:
    """Return the plan with the least violation of the rule; none if slack has no price."""
    problem, rule = case.problem, case.problem.constraints.rule
    if problem.task == "reach" or (rule.by_step and rule.slack_max_db is None):
        return []
    elastic = replace(rule, slack_max_db=MOST_DB, slack_price=SLACK_PRICE)
    constraints = replace(problem.constraints, rule=elastic)
    plan = trials.plan(replace(problem, constraints=constraints))
    return [] if plan is None else [replace(case, plan=plan)]


def _lacking(fault: Fault, key: Key, cases: list[Case]) -> float:
    """Return the estimated amount by which a key must be loosened."""
    case = cases[0]
    if fault.missed != "connection":
        return min(fault.shortfall, key.most)
    if _met_nowhere(case):
        least = fault.shortfall
        if key.name == "constraints.p_min":
            least = key.value - best_probability(case.own, case.posteriors)
        if least > 0.0:
            return min(least, key.most)
    amounts = (
        least_amount(lambda amount, each=each: _is_kept(each, key, amount), key.most)
        for each in cases
    )
    return min((amount for amount in amounts if amount is not None), default=key.most)


def _is_kept(case: Case, key: Key, amount: float) -> bool:
    """Return whether the plan's path satisfies the rule with a loosened key."""
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
    margins = margins_asked_db(problem, power) + (rule.slack_max_db or 0.0)
    kept = margins[[step - 1 for step in plan.certificate.relaxed_steps]] >= -MARGIN_TOLERANCE_DB
    return bool(kept.any() if _met_nowhere(case) else kept.all())
