"""The answer to one planning problem of several robots: a plan for each."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.channel.belief import Belief
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.plan import Plan, Verdict
from planopt.planning.worth.aim import Aim
from planopt.problems.problem import Problem


@dataclass(frozen=True, eq=False)
class TeamSolution:
    """One solved problem whose objective is a sum of terms.

    Attributes
    ----------
    problem, seed
        As solved (overrides applied).
    belief
        What all plans were made from.
    plans, aims
        By robot: its plan, and what it was made for.
    explanation
        What would give each robot a verified plan, where that was asked for and it has none.
    """

    problem: Problem
    seed: int
    belief: Belief
    plans: tuple[Plan, ...]
    aims: tuple[Aim, ...]
    explanation: tuple[Relaxation, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The worst of the plans' verdicts."""
        return max((plan.verdict for plan in self.plans), key=list(Verdict).index)
