"""The time budget of a plan: until when searches go on and refinements begin, and their limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

from planopt.problems.problem import Problem

SEARCH_SHARE = 0.3
"""Searches improve on what they have found until this share of a budget is over."""
SOLVE_SHARE = 0.4
"""No solve takes longer than this share of a budget."""
PROOF_SHARE = 0.1
"""This share is left for the proof of the last solve's path."""


@dataclass(frozen=True)
class Budget:
    """Times by :func:`time.perf_counter`; infinite where there is no limit."""

    ends_s: float = math.inf  # No new refinement begins any more
    search_ends_s: float = math.inf  # What searches have found by then has to do
    # No further candidate is judged any more where there is one that may be released
    proof_ends_s: float = math.inf

    @property
    def spent(self) -> bool:
        """Return whether no new refinement may begin."""
        return perf_counter() >= self.ends_s

    @property
    def searched(self) -> bool:
        """Return whether searches end with what they have."""
        return perf_counter() >= self.search_ends_s

    @property
    def proven(self) -> bool:
        """Return whether no further candidate is judged."""
        return perf_counter() >= self.proof_ends_s


UNLIMITED = Budget()
"""No limit."""


def budget_from(problem: Problem, begun_s: float) -> Budget:
    """The budget of a plan that was begun at `begun_s`, by :func:`time.perf_counter`.

    The last solve begins early enough to end, and to be judged, within it.
    """
    budget_s = problem.planner.budget_s
    if budget_s is None:
        return UNLIMITED
    return Budget(
        ends_s=begun_s + (1.0 - SOLVE_SHARE - PROOF_SHARE) * budget_s,
        search_ends_s=begun_s + SEARCH_SHARE * budget_s,
        proof_ends_s=begun_s + (1.0 - PROOF_SHARE) * budget_s,
    )


def solve_limit_s(problem: Problem) -> float | None:
    """Return how long one solve may take; None where there is no limit."""
    budget_s = problem.planner.budget_s
    return None if budget_s is None else SOLVE_SHARE * budget_s
