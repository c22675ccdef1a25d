"""Plans that keep p_min at each step, or at those that end at stated times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction
from planopt.objectives.told_batch import Pull, WayBatch
from planopt.planning.history import BEGINNING
from planopt.planning.plan import Plan
from planopt.planning.worth.rules.planned import (
    BestWithin,
    Guide,
    GuidedSearch,
    IsKept,
    PlannedRule,
    RuleRows,
    held_rows,
    slope_of_missing_db,
    ways_margins_db,
)
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem


class PlannedSteps(PlannedRule):
    """p_min at steps, each by itself."""

    def _asked(self, at: Situation, count: int) -> NDArray[np.bool_]:
        return self.proven.asked_steps(at.problem, at.circumstances.history, count)

    def rows(self, situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
        """Return a bound on each step asked for."""
        problem = situation.problem
        asked = self._asked(situation, len(path_m)) & problem.constraints.asks_connection
        return held_rows(problem, asked)

    def find_guided(
        self, situation: Situation, search: GuidedSearch, is_kept: IsKept
    ) -> list[NDArray[np.float64]]:
        """Return paths that keep the bound where it is asked for."""
        problem, count = situation.problem, situation.problem.planner.horizon
        asked = self._asked(situation, count) & problem.constraints.asks_connection
        return search(Guide(problem.constraints.p_min, asked, np.zeros(count)))

    def missing(
        self, at: Situation, legs_m: NDArray[np.float64], power: Prediction
    ) -> NDArray[np.float64]:
        """Return the missing dB of all steps asked for."""
        margins = ways_margins_db(at, legs_m.shape, power, at.problem.constraints.p_min)
        return (np.maximum(-margins, 0.0) * self._asked(at, legs_m.shape[1])).sum(axis=1)

    def missing_slope(self, at: Situation, batch: WayBatch) -> Pull:
        """Return its derivatives."""
        asked = self._asked(at, batch.shape[1])
        return slope_of_missing_db(at, batch, at.problem.constraints.p_min, asked)

    def is_possible(self, best: BestWithin) -> bool:
        """Return whether a step can keep the bound, or each where slack is bounded."""
        margins, rule = best.margins_db(), best.problem.constraints.rule
        asked = self.proven.asked_steps(best.problem, BEGINNING, len(margins))
        kept = margins[asked] >= 0.0
        return bool(kept.any() if rule.slack_max_db is None else kept.all())

    def weak_steps(self, problem: Problem, plan: Plan) -> NDArray[np.bool_]:
        """Return the steps below p_min."""
        return plan.connectivity[1:] < problem.constraints.p_min
