"""Plans without long outages: the steps that end an outage in time are held.

Which steps are held is chosen about a start path, as few as possible.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction
from planopt.planning.history import History
from planopt.planning.plan import Plan
from planopt.planning.proof.rules.asked import margin_missed
from planopt.planning.proof.rules.outage import longest_run
from planopt.planning.tolerances import margins_asked_db
from planopt.planning.worth.rules.planned import (
    BestWithin,
    Guide,
    GuidedSearch,
    IsKept,
    PlannedRule,
    RuleRows,
    held_rows,
    ways_margins_db,
)
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem

ROUNDING = 1e-9
"""A run may be longer than is allowed by this share: sums of steps are rounded."""

PATTERNS = 4
"""In so many ways the steps that end an outage are chosen."""


class PlannedOutage(PlannedRule):
    """Steps below p_min in a row are no longer than stated."""

    more_steps: ClassVar[bool] = False

    def rows(self, situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
        """Return a bound on each step that is held."""
        return held_rows(situation.problem, held_steps(situation, path_m))

    def find_guided(
        self, situation: Situation, search: GuidedSearch, is_kept: IsKept
    ) -> list[NDArray[np.float64]]:
        """Return paths that hold patterns of steps, and all."""
        problem, count = situation.problem, situation.problem.planner.horizon
        legs = np.full(count, problem.step_length_m)
        sizes, limit, before = _measured(problem, situation.circumstances.history, legs)
        patterns = _patterns(sizes, limit * (1.0 + ROUNDING), before)
        p_min, no_credit = problem.constraints.p_min, np.zeros(count)
        every = np.ones(count, dtype=np.bool_)
        guides = [Guide(p_min, asked, no_credit) for asked in (*patterns, every)]
        return [path for guide in guides for path in search(guide)]

    def missing(
        self, at: Situation, legs_m: NDArray[np.float64], power: Prediction
    ) -> NDArray[np.float64]:
        """Return by how many steps the longest outage is too long."""
        problem, history = at.problem, at.circumstances.history
        rule = problem.constraints.rule
        missed = ways_margins_db(at, legs_m.shape, power, problem.constraints.p_min) < 0.0
        if rule.outage_max_m is not None:
            excess = _excess(legs_m, missed, rule.outage_max_m, history.outage_m)
            return excess / problem.step_length_m
        limit = (rule.outage_max_s or 0.0) / problem.planner.step_s
        return _excess(np.ones_like(legs_m), missed, limit, float(history.outage_steps))

    def is_possible(self, best: BestWithin) -> bool:
        """Return whether the steps at which nothing keeps the bound are no outage too long."""
        margins, problem = best.margins_db(), best.problem
        most_s = problem.constraints.rule.outage_max_s
        longest = longest_run(np.full(len(margins), problem.planner.step_s), margins < 0.0, 0.0)
        return most_s is None or longest <= most_s * (1.0 + 1e-9)

    def weak_steps(self, problem: Problem, plan: Plan) -> NDArray[np.bool_]:
        """Return the steps in rows of missed ones that are longer than is allowed."""
        power = Prediction(plan.mean_dbm[1:], plan.deviation_db[1:])
        missed = margin_missed(margins_asked_db(problem, power))
        legs = np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1)
        sizes, limit, _ = _measured(problem, History(), legs)
        row = np.cumsum(np.diff(missed, prepend=False))
        long = [number for number in np.unique(row[missed]) if sizes[row == number].sum() > limit]
        return missed & np.isin(row, long)


def _measured(
    problem: Problem, history: History, legs_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, float]:
    """Sizes of steps (N,), the longest outage, and what has been of one, in metres or seconds."""
    rule, step_s = problem.constraints.rule, problem.planner.step_s
    if rule.outage_max_m is not None:
        return legs_m, rule.outage_max_m, history.outage_m
    before_s = history.outage_steps * step_s
    return np.full(len(legs_m), step_s), rule.outage_max_s or 0.0, before_s


def _excess(
    sizes: NDArray[np.float64], missed: NDArray[np.bool_], limit: float, before: float
) -> NDArray[np.float64]:
    """Return how much longer than `limit` the longest run of missed steps is; ``(c,)``."""
    run = np.full(len(sizes), before)
    longest = np.zeros(len(sizes))
    for size, out in zip(sizes.T, missed.T, strict=True):
        run = np.where(out, run + size, 0.0)
        longest = np.maximum(longest, run)
    return np.maximum(longest - limit, 0.0)


def _patterns(sizes: NDArray[np.float64], limit: float, before: float) -> list[NDArray[np.bool_]]:
    """Steps that are held so that no run of others is too long; the first as late as may be.

    In the others it is held earlier, up to `PATTERNS` evenly, and those after it with it.
    """
    latest = fewest_held(sizes, np.ones(len(sizes), dtype=bool), limit, before)
    last = int(np.argmax(latest)) if latest.any() else 0
    patterns = [latest]
    for first in np.unique(np.linspace(0, last, PATTERNS).astype(np.intp))[:-1].tolist():
        held = np.zeros(len(sizes), dtype=bool)
        held[first] = True
        rest = sizes[first + 1 :]
        held[first + 1 :] = fewest_held(rest, np.ones(len(rest), dtype=bool), limit, 0.0)
        patterns.append(held)
    return patterns


def held_steps(situation: Situation, path_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Steps that must keep p_min so that no outage is too long; the fewest of a path (N, 2).

    As few as possible of the steps at which the path keeps it, each the last before an outage would
    be too long. Where it keeps too few, steps at which it does not are held besides.
    """
    problem, history = situation.problem, situation.circumstances.history
    keeps = margins_asked_db(problem, situation.power(path_m)) >= 0.0
    ends = np.vstack([situation.position_m, path_m])
    legs = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    sizes, limit, before = _measured(problem, history, legs)
    return fewest_held(sizes, keeps, limit * (1.0 + ROUNDING), before)


def fewest_held(
    sizes: NDArray[np.float64], keeps: NDArray[np.bool_], limit: float, before: float
) -> NDArray[np.bool_]:
    """Return which steps to hold so that no run of others is above `limit`; ``(n,)``."""
    # Shapes: sizes (n,); keeps (n,).
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
