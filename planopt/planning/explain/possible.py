"""Bound what any plan can achieve of the rule of connectivity, from the places within reach.

Necessary, not sufficient: the best place within reach by each step is taken for the step's own, as
if all could be had together. No planner needs to try what it rules out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.history import BEGINNING
from planopt.planning.proof.goal_paths import build_goal_grid
from planopt.planning.proof.predictions import broad_prediction, search_prediction
from planopt.planning.proof.reachability import COARSE_NODES, best_margins_by_step, may_reach_from
from planopt.planning.proof.rules.each_step import counted_steps
from planopt.planning.proof.rules.rule import rule_of
from planopt.planning.proof.single_steps import is_priced
from planopt.planning.tolerances import margins_asked_db
from planopt.problems.problem import Problem
from planopt.world.clearance import index_obstacles


def best_probability(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> float:
    """Largest probability of connection at a place that a step which is asked for comes to.

    It is the largest ``p_min`` that the verifier can find to be met at any of them.
    """
    radio, least = problem.stations[0], problem.constraints.p_min

    def beyond(power: Prediction) -> NDArray[np.float64]:
        return (
            connection_probability(power.mean_db, power.deviation_db, radio.threshold_dbm) - least
        )

    return least + float(_of_asked(problem, best_by_step(problem, posteriors, beyond)).max())


def best_margin_db(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> float:
    """Largest margin in dB at a place that a step which is asked for comes to."""
    margins = best_by_step(problem, posteriors, partial(margins_asked_db, problem))
    return float(_of_asked(problem, margins).max())


def best_by_step(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    score: Callable[[Prediction], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Largest score within reach by each step of the horizon, searched for as margins are; (N,).

    Where it is negative, the search looks closer. Where steps may miss the bound at a price, the
    whole workspace is within reach.
    """
    broad = broad_prediction(problem, posteriors)
    if is_priced(problem):
        places = build_goal_grid(problem, index_obstacles(problem.workspace)).nodes_m
        found = score(search_prediction(posteriors[0], places, broad)).max()
        return np.full(problem.planner.horizon, float(found))
    state = problem.robots[0].start_state
    best = best_margins_by_step(
        index_obstacles(problem.workspace),
        problem.workspace.bounds_m,
        lambda places: score(search_prediction(posteriors[0], places, broad)),
        state[:2],
        problem.step_length_m,
        np.arange(1, problem.planner.horizon + 1),
        problem.constraints.clearance_m,
        may_reach_from(problem, state),
    )
    return np.array(best)


def _of_asked(problem: Problem, best: NDArray[np.float64]) -> NDArray[np.float64]:
    return best[counted_steps(problem, BEGINNING, len(best))]


GRID_ERROR_DB = 0.1
GRID_ERROR_STEPS = 1.0 / 32.0
"""A place between the nodes of the search may be better by so many dB, or farther by so many
steps."""

MOST_PLACES = 50_000
"""Where the search would have more places, everything is taken as possible."""


def is_possible(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> bool:
    """Return whether what is within reach by each step does not rule the rule out."""
    constraints, steps = problem.constraints, problem.planner.horizon
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    places = (x_max - x_min) * (y_max - y_min) * (COARSE_NODES / problem.step_length_m) ** 2
    if min(places, 4.0 * (steps * COARSE_NODES) ** 2) > MOST_PLACES:
        return True
    rule = constraints.rule
    eased = _eased(problem, (rule.slack_max_db or 0.0) + GRID_ERROR_DB)
    if rule.by_step:
        margins = best_by_step(eased, posteriors, lambda power: margins_asked_db(eased, power))
        kept = _of_asked(eased, margins) >= 0.0
        return bool(kept.any() if rule.slack_max_db is None else kept.all())
    own = rule_of(eased)
    if own.holds_steps or own.correlates(constraints.p_min):
        return True
    achieved = own.valued(_chances(eased, posteriors), BEGINNING)
    return bool(achieved >= own.required(constraints.p_min, BEGINNING, steps))


def _chances(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> NDArray[np.float64]:
    threshold = problem.stations[0].threshold_dbm

    def chance(power: Prediction) -> NDArray[np.float64]:
        # Below zero, so that the search goes on to refine.
        return connection_probability(power.mean_db, power.deviation_db, threshold) - 1.0

    return best_by_step(problem, posteriors, chance) + 1.0


def _eased(problem: Problem, by_db: float) -> Problem:
    """The problem with thresholds lower, and a robot that turns at will a little faster."""
    stations = tuple(replace(s, threshold_dbm=s.threshold_dbm - by_db) for s in problem.stations)
    robot = problem.robots[0]
    # Where the whole workspace counts the grid must stay the verifier's own.
    if robot.dynamics is None and not is_priced(problem):
        robot = replace(robot, speed_max_m_s=robot.speed_max_m_s * (1.0 + GRID_ERROR_STEPS))
    return replace(problem, stations=stations, robots=(robot,))
