"""By how much many ways miss the rule of connectivity, all at once: for choosing among them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_margin_db, connection_probability
from planopt.planning.proof.rules.asked import (
    asked_steps,
    connected_steps_asked,
    data_asked_mbit,
)
from planopt.planning.worth.situation import Situation


def ways_missing(
    at: Situation, legs_m: NDArray[np.float64], power: Prediction
) -> NDArray[np.float64]:
    """A measure of what each way lacks, 0 where it keeps the rule; ``(c,)``.

    In dB of all steps; of an expectation in steps or Mbit; of outages in steps. The bound on all
    steps together is asked of each step as if outages were independent.

    Parameters
    ----------
    at
        What is known.
    legs_m
        ``(c, N)`` lengths of the ways' steps.
    power
        Prediction at all places, those of a way together; ``(c N,)``.
    """
    problem, history = at.problem, at.circumstances.history
    constraints, count = problem.constraints, legs_m.shape[1]
    threshold, p_min = problem.stations[0].threshold_dbm, constraints.p_min
    rule = constraints.rule

    def margins(level: float) -> NDArray[np.float64]:
        return bound_margin_db(power.mean_db, power.deviation_db, threshold, level).reshape(
            legs_m.shape
        )

    def chance() -> NDArray[np.float64]:
        return connection_probability(power.mean_db, power.deviation_db, threshold).reshape(
            legs_m.shape
        )

    match rule.connectivity:
        case "average":
            asked = connected_steps_asked(problem, history, count)
            return np.maximum(asked - chance().sum(axis=1), 0.0)
        case "data":
            each, asked = data_asked_mbit(problem, history, count)
            return np.maximum(asked - chance() @ each, 0.0)
        case "joint":
            return np.maximum(-margins(p_min ** (1.0 / count)), 0.0).sum(axis=1)
        case "outage":
            missed = margins(p_min) < 0.0
            if rule.outage_max_m is not None:
                excess = _excess(legs_m, missed, rule.outage_max_m, history.outage_m)
                return excess / problem.step_length_m
            step_s = problem.planner.step_s
            limit = (rule.outage_max_s or 0.0) / step_s
            return _excess(np.ones_like(legs_m), missed, limit, float(history.outage_steps))
        case _:
            asked_of = asked_steps(problem, history, count)
            return (np.maximum(-margins(p_min), 0.0) * asked_of).sum(axis=1)


def _excess(
    sizes: NDArray[np.float64], missed: NDArray[np.bool_], limit: float, before: float
) -> NDArray[np.float64]:
    """How much longer than `limit` the longest run of missed steps is, by row; ``(c,)``."""
    run = np.full(len(sizes), before)
    longest = np.zeros(len(sizes))
    for size, out in zip(sizes.T, missed.T, strict=True):
        run = np.where(out, run + size, 0.0)
        longest = np.maximum(longest, run)
    return np.maximum(longest - limit, 0.0)
