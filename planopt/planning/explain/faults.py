"""The constraints that a plan violates, with steps and shortfall."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.explain.keys import Missed
from planopt.planning.history import BEGINNING
from planopt.planning.plan import Plan
from planopt.planning.proof.connectivity_rules import counted_steps
from planopt.planning.proof.context import connectivity_law, search_prediction
from planopt.planning.proof.rule import rule_of
from planopt.planning.proof.searches import best_margins_by_step, build_goal_grid, may_reach_from
from planopt.planning.proof.verify import is_priced
from planopt.planning.tolerances import (
    CLEARANCE_TOLERANCE_M,
    MARGIN_TOLERANCE_DB,
    margins_asked_db,
)
from planopt.planning.values.rule_rows import common_level
from planopt.problems.problem import Problem, problem_of_robot
from planopt.robots.drive import braked_motion
from planopt.world.clearance import index_obstacles
from planopt.world.motion import step_distances_m
from planopt.world.moving_discs import MovingDiscs


@dataclass(frozen=True, eq=False)
class Case:
    """One robot's plan from the start of a run."""

    problem: Problem  # With all robots
    number: int  # Of the robot
    posteriors: Sequence[ChannelPosterior]  # The belief that it was planned on, by station
    plan: Plan
    # Moving obstacles, and the plans of other robots if a separation is required
    moving: MovingDiscs

    @property
    def own(self) -> Problem:
        """Return the problem with this robot alone."""
        return problem_of_robot(self.problem, self.number)


@dataclass(frozen=True)
class Fault:
    """A constraint that a plan violates."""

    missed: Missed
    stages: tuple[int, ...]  # Its steps; 1 is the first
    shortfall: float  # The violation
    unit: str  # Of the shortfall; empty for a probability


def faults_of(case: Case) -> tuple[Fault, ...]:
    """Return all violated constraints but those of the motion."""
    connection = _connection(case)
    found = [] if connection is None else [connection]
    return (*found, *_distances(case))


def met_nowhere(case: Case) -> bool:
    """Return whether p_min is required of single steps without slack, and all miss it."""
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
        # The shortfall of the best place, if that is negative itself.
        best_db = best_margin_db(problem, case.posteriors)
        short_db = -best_db if best_db < 0.0 else short_db
    elif rule.slack_max_db is None and max(certificate.best_margin_db) < 0.0:
        return None  # nothing within reach keeps these steps, which excuses them
    return Fault("connection", stages, short_db, "dB")


def _distances(case: Case) -> list[Fault]:
    """Return violated distances of robots and moving obstacles at equal times.

    Violations while a robot brakes after the last step belong to the last step.
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


def _level(problem: Problem, steps: int) -> float:
    """Return the probability that equal steps of a plan would need."""
    constraints, rule = problem.constraints, rule_of(problem, np.ones(steps))
    if constraints.rule.kind.holds_steps:
        return constraints.p_min
    return common_level(rule, constraints.p_min, BEGINNING, steps)


def _stages(which: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple((np.flatnonzero(which) + 1).tolist())


def best_probability(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> float:
    """Return the largest ``p_min`` that a step which counts can satisfy at any reachable place."""
    radio, least = problem.stations[0], problem.constraints.p_min

    def beyond(power: Prediction) -> NDArray[np.float64]:
        return (
            connection_probability(power.mean_db, power.deviation_db, radio.threshold_dbm) - least
        )

    return least + float(_of_asked(problem, _best_by_step(problem, posteriors, beyond)).max())


def best_margin_db(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> float:
    """Return the largest margin in dB at any reachable place of a step which counts."""
    margins = _best_by_step(problem, posteriors, partial(margins_asked_db, problem))
    return float(_of_asked(problem, margins).max())


def _best_by_step(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    score: Callable[[Prediction], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return the largest score within reach by each step of the horizon; (N,).

    The search refines negative scores. If steps may miss p_min at a price, the whole workspace is
    within reach.
    """
    law = connectivity_law(problem, posteriors)
    if is_priced(problem):
        places = build_goal_grid(problem, index_obstacles(problem.workspace)).nodes_m
        found = score(search_prediction(law, places)).max()
        return np.full(problem.planner.horizon, float(found))
    state = problem.robots[0].start_state
    best = best_margins_by_step(
        index_obstacles(problem.workspace),
        problem.workspace.bounds_m,
        lambda places: score(search_prediction(law, places)),
        state[:2],
        problem.step_length_m,
        np.arange(1, problem.planner.horizon + 1),
        problem.constraints.clearance_m,
        may_reach_from(problem, state),
    )
    return np.array(best)


def _of_asked(problem: Problem, best: NDArray[np.float64]) -> NDArray[np.float64]:
    return best[counted_steps(problem, BEGINNING, len(best))]
