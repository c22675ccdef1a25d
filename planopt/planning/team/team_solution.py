"""The answer to one planning problem of several robots: a plan for each."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.channel.belief import Belief
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.plan import Plan, Verdict
from planopt.planning.short_results import only, short_solution
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

    def __repr__(self) -> str:
        """Return what was solved, the verdict, and a line for each plan."""
        return short_solution(self.problem, self.seed, self.plans)

    @property
    def plan(self) -> Plan:
        """The plan, where there is one robot; of several see `plans`.

        Raises
        ------
        InputError
            There are several.
        """
        return only(self.plans, "plans")

    @property
    def verdict(self) -> Verdict:
        """The worst of the plans' verdicts."""
        return max((plan.verdict for plan in self.plans), key=list(Verdict).index)
