"""How much connectivity there is within reach, by the verifier's own searches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.bound_margins import margins_asked_db
from planopt.planning.history import BEGINNING
from planopt.planning.proof.broad_prediction import broad_prediction
from planopt.planning.proof.goal_paths import build_goal_grid
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.proof.reachability import best_margins_by_step, may_reach_from
from planopt.planning.proof.rules.asked import is_priced
from planopt.planning.proof.rules.proven import asked_steps
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
    return best[asked_steps(problem, BEGINNING, len(best))]
