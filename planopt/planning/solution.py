"""The answer to one planning problem: the plan and everything needed to judge it."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.channel.belief import Belief
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.plan import Plan, Verdict
from planopt.planning.short_results import short_solution
from planopt.problems.problem import Problem


@dataclass(frozen=True)
class Solution:
    """One solved problem.

    Attributes
    ----------
    problem
        As solved (overrides applied).
    seed
        Of the truth's fading and of the measured places.
    belief
        What the plan was made from.
    plan
        The plan.
    explanation
        What would give a verified plan, where that was asked for and this one is not.
    """

    problem: Problem
    seed: int
    belief: Belief
    plan: Plan
    explanation: tuple[Relaxation, ...] = ()

    def __repr__(self) -> str:
        """Return what was solved, the verdict, and a line for the plan."""
        return short_solution(self.problem, self.seed, self.plans)

    @property
    def plans(self) -> tuple[Plan]:
        """The plan alone, as what has several robots has several."""
        return (self.plan,)

    @property
    def verdict(self) -> Verdict:
        """The plan's."""
        return self.plan.verdict


def exit_code(solution: Solution) -> int:
    """0 verified, 3 solved but not verified, 4 no plan."""
    return {"verified": 0, "none": 4}.get(solution.verdict.value, 3)
