"""How long a plan may take: when the last polish may begin, and how long one may take."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

from planopt.problems.problem import Problem

SOLVE_SHARE = 0.4
"""No solve takes longer than this share of a budget."""
PROOF_SHARE = 0.1
"""This share is left for the proof of the last solve's path."""


@dataclass(frozen=True)
class Budget:
    """The time at which no new polish begins any more.

    Attributes
    ----------
    ends_s
        By :func:`time.perf_counter`; infinite where there is no limit.
    """

    ends_s: float = math.inf

    @property
    def spent(self) -> bool:
        """Whether it is over."""
        return perf_counter() >= self.ends_s


def budget_from(problem: Problem, begun_s: float) -> Budget:
    """The budget of a plan that was begun at `begun_s`, by :func:`time.perf_counter`.

    The last solve begins early enough to end, and to be judged, within it.
    """
    budget_s = problem.planner.budget_s
    if budget_s is None:
        return Budget()
    return Budget(begun_s + (1.0 - SOLVE_SHARE - PROOF_SHARE) * budget_s)


def solve_limit_s(problem: Problem) -> float | None:
    """How long one solve may take; None where there is no limit."""
    budget_s = problem.planner.budget_s
    return None if budget_s is None else SOLVE_SHARE * budget_s
