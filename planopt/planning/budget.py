"""How long a plan may be polished."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

from planopt.problems.problem import Problem


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
    """The budget of a plan that was begun at `begun_s`, by :func:`time.perf_counter`."""
    budget_s = problem.planner.budget_s
    return Budget() if budget_s is None else Budget(begun_s + budget_s)
