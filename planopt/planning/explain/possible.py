"""Whether some plan could keep the rule of connectivity, by what there is within reach at most.

Necessary, not sufficient: the best place within reach by each step is taken for the step's own, as
if all could be had together. What it denies, no planner needs to try.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.bound_margins import margins_asked_db
from planopt.planning.explain.reach_limits import best_by_step
from planopt.planning.proof.reachability import COARSE_NODES
from planopt.planning.proof.rules.asked import is_priced
from planopt.planning.worth.rules.planned import BestWithin, planned_rule
from planopt.problems.problem import Problem

GRID_ERROR_DB = 0.1
GRID_ERROR_STEPS = 1.0 / 32.0
"""A place between the nodes of the search may be better by so many dB, or farther by so many
steps."""

MOST_PLACES = 50_000
"""Where the search would have more places, everything is taken as possible."""


def is_possible(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> bool:
    """Whether what is within reach by each step does not rule the rule out.

    Parameters
    ----------
    problem
        With one robot.
    posteriors
        What is believed of the channel.
    """
    constraints, steps = problem.constraints, problem.planner.horizon
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    places = (x_max - x_min) * (y_max - y_min) * (COARSE_NODES / problem.step_length_m) ** 2
    if min(places, 4.0 * (steps * COARSE_NODES) ** 2) > MOST_PLACES:
        return True
    rule = constraints.rule
    eased = _eased(problem, (rule.slack_max_db or 0.0) + GRID_ERROR_DB)
    best = BestWithin(
        eased,
        lambda: best_by_step(eased, posteriors, lambda power: margins_asked_db(eased, power)),
        lambda: _chances(eased, posteriors),
    )
    return planned_rule(rule).is_possible(best)


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
