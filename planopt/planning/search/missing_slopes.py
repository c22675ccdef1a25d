"""How what ways miss of the rule of connectivity changes with their places."""

from __future__ import annotations

import numpy as np

from planopt.channel.prediction import bound_quantile
from planopt.objectives.way_batch import WayBatch
from planopt.objectives.way_slopes import Pull, pull_of_power
from planopt.planning.proof.rules.asked import asked_steps
from planopt.planning.proof.serving import connection_law
from planopt.planning.worth.situation import Situation


def missing_slope(at: Situation, batch: WayBatch) -> Pull:
    """Derivatives of :func:`planopt.planning.search.ways_missing.ways_missing` that adds up dB.

    Nothing for rules that count otherwise: a way then climbs as if there were none, but no step
    that misses more is taken.
    """
    problem, (count, steps) = at.problem, batch.shape
    rule, p_min = problem.constraints.rule.connectivity, problem.constraints.p_min
    if rule in ("average", "data", "outage"):
        return Pull()
    asked = asked_steps(problem, at.circumstances.history, steps)
    if rule == "joint":
        p_min, asked = p_min ** (1.0 / steps), np.ones(steps, dtype=np.bool_)
    power, law = batch.power, connection_law(at.posterior)
    quantile = bound_quantile(p_min) if law is None else law.quantile(p_min)
    margin = power.mean_db - quantile * power.deviation_db - problem.stations[0].threshold_dbm
    missed = ((margin < 0.0).reshape(count, steps) & asked).astype(np.float64)
    return pull_of_power(batch, -missed, quantile * missed)
