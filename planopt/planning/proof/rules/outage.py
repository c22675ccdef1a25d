"""The rule on outages: steps below p_min in a row are no longer than stated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.certificate import RuleResult
from planopt.planning.history import History
from planopt.planning.proof.rules.asked import margin_missed
from planopt.problems.problem import Problem


def outage_result(
    problem: Problem,
    history: History,
    positions_m: NDArray[np.float64],  # (N + 1, 2) the path, the robot's own place first
    margin_db: NDArray[np.float64],  # (N,) of the bound after each step
) -> RuleResult:
    """Longest way or time of steps below p_min in a row.

    An outage that the robot is in counts with what it has lasted, if the first step prolongs it.
    """
    rule, step_s = problem.constraints.rule, problem.planner.step_s
    missed = margin_missed(margin_db)
    if rule.outage_max_m is not None:
        legs = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
        longest = longest_run(legs, missed, history.outage_m)
        return RuleResult("outage", longest, rule.outage_max_m, "m", "steps below p_min in a row")
    if rule.outage_max_s is None:
        raise AssertionError("no outage is bounded")
    before_s = history.outage_steps * step_s
    longest = longest_run(np.full(len(missed), step_s), missed, before_s)
    return RuleResult("outage", longest, rule.outage_max_s, "s", "steps below p_min in a row")


def longest_run(sizes: NDArray[np.float64], missed: NDArray[np.bool_], before: float) -> float:
    """The greatest sum of `sizes` (n,) over successive steps that are `missed` (n,).

    `before` is added to the run that begins with the first step, if it does.
    """
    longest, current = 0.0, before
    for size, out in zip(sizes.tolist(), missed.tolist(), strict=True):
        current = current + size if out else 0.0
        longest = max(longest, current)
    return longest
