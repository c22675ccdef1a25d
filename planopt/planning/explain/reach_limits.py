"""How much connectivity there is within reach, by the verifier's own searches."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.planning.bound_margins import margins_asked_db
from planopt.planning.proof.broad_prediction import broad_prediction
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.proof.reach_of_dynamics import may_reach_from
from planopt.planning.proof.reachability import COARSE_NODES, best_margins_by_step
from planopt.problems.problem import Problem
from planopt.problems.settings import MAX_HORIZON
from planopt.world.clearance import index_obstacles

MOST_PLACES = 200_000
"""A longer horizon is not looked for where the search would have more places."""


def best_probability(
    problem: Problem, posteriors: Sequence[ChannelPosterior], start_m: NDArray[np.float64]
) -> float:
    """Largest probability of connection at a place that the horizon's steps come to.

    It is the largest ``p_min`` that the verifier can find to be met at any of them.
    """
    radio, least = problem.stations[0], problem.constraints.p_min

    def beyond(power: Prediction) -> NDArray[np.float64]:
        return (
            connection_probability(power.mean_db, power.deviation_db, radio.threshold_dbm) - least
        )

    return least + _best(problem, posteriors, start_m, beyond, [problem.planner.horizon])[0]


def best_margin_db(
    problem: Problem, posteriors: Sequence[ChannelPosterior], start_m: NDArray[np.float64]
) -> float:
    """Largest margin in dB at a place that the horizon's steps come to."""
    margin = partial(margins_asked_db, problem)
    return _best(problem, posteriors, start_m, margin, [problem.planner.horizon])[0]


def least_horizon(
    problem: Problem, posteriors: Sequence[ChannelPosterior], start_m: NDArray[np.float64]
) -> int | None:
    """Fewest steps that come to a place that keeps the bound; None if none is found."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    step = problem.step_length_m
    across = math.ceil(math.hypot(x_max - x_min, y_max - y_min) / step)
    last = min(MAX_HORIZON, across)
    places = (x_max - x_min) * (y_max - y_min) * (COARSE_NODES / step) ** 2
    if last <= problem.planner.horizon or places > MOST_PLACES:
        return None
    steps = list(range(problem.planner.horizon + 1, last + 1))
    margins = _best(problem, posteriors, start_m, partial(margins_asked_db, problem), steps)
    return next((n for n, margin in zip(steps, margins, strict=True) if margin >= 0.0), None)


def _best(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    start_m: NDArray[np.float64],
    score: Callable[[Prediction], NDArray[np.float64]],
    steps: Sequence[int],
) -> tuple[float, ...]:
    """Largest score within reach by each of some steps, searched for as margins are."""
    broad = broad_prediction(problem, posteriors)
    return best_margins_by_step(
        index_obstacles(problem.workspace),
        problem.workspace.bounds_m,
        lambda places: score(search_prediction(posteriors[0], places, broad)),
        start_m,
        problem.step_length_m,
        np.asarray(steps, dtype=np.intp),
        problem.constraints.clearance_m,
        may_reach_from(problem, problem.robots[0].start_state),
    )
