"""Which steps of a path are held so that no outage is too long: the fewest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.bound_margins import margins_asked_db
from planopt.planning.worth.situation import Situation

ROUNDING = 1e-9
"""A run may be longer than is allowed by this share: sums of steps are rounded."""


def held_steps(situation: Situation, path_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Steps that must keep p_min so that no outage is too long; the fewest of a path (N, 2).

    As few as possible of the steps at which the path keeps it, each the last before an outage would
    be too long. Where it keeps too few, steps at which it does not are held besides.
    """
    problem, history = situation.problem, situation.circumstances.history
    rule, step_s = problem.constraints.rule, problem.planner.step_s
    keeps = margins_asked_db(problem, situation.power(path_m)) >= 0.0
    if rule.outage_max_m is not None:
        ends = np.vstack([situation.position_m, path_m])
        sizes = np.linalg.norm(np.diff(ends, axis=0), axis=1)
        limit, before = rule.outage_max_m, history.outage_m
    else:
        sizes = np.full(len(path_m), step_s)
        limit, before = rule.outage_max_s or 0.0, history.outage_steps * step_s
    return fewest_held(sizes, keeps, limit * (1.0 + ROUNDING), before)


def fewest_held(
    sizes: NDArray[np.float64], keeps: NDArray[np.bool_], limit: float, before: float
) -> NDArray[np.bool_]:
    """Which steps to hold so that no run of others is above `limit`; ``(n,)``.

    Parameters
    ----------
    sizes
        ``(n,)`` of the steps.
    keeps
        ``(n,)`` steps that can be held for nothing.
    limit, before
        The longest run, and what a run from the first step on has had already.
    """
    held = np.zeros(len(sizes), dtype=bool)
    run, last = before, -1
    for step, size in enumerate(sizes.tolist()):
        run += size
        if run <= limit:
            continue
        within = np.flatnonzero(keeps[last + 1 : step + 1])
        last = last + 1 + int(within[-1]) if len(within) else step
        held[last] = True
        run = float(sizes[last + 1 : step + 1].sum())
    return held
