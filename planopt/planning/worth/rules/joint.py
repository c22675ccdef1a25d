"""Plans whose steps are all connected together with probability p_min.

The risk that is allowed to a plan is allocated to its steps (equation 5.6).
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, connection_probability
from planopt.objectives.told_batch import Pull, WayBatch
from planopt.planning.plan import Plan
from planopt.planning.proof.rules.asked import is_missed
from planopt.planning.proof.rules.path_draws import joint_by_slack
from planopt.planning.worth.risk_allocation import LARGEST_RISK, allocated_again
from planopt.planning.worth.rules.planned import (
    BestWithin,
    Guide,
    GuidedSearch,
    IsKept,
    PlannedRule,
    RuleRows,
    slope_of_missing_db,
    ways_margins_db,
)
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem


class PlannedJoint(PlannedRule):
    """The planner's half of the rule that all steps together are connected."""

    allocates: ClassVar[bool] = True
    more_steps: ClassVar[bool] = False

    def rows(self, situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
        """Return a bound on each step at the level of its share of the risk."""
        level = 1.0 - first_risk(situation, path_m)
        every = np.ones(len(path_m), dtype=np.bool_)
        return RuleRows(situation.problem.stations[0].threshold_dbm, level, every)

    def find_guided(
        self, situation: Situation, search: GuidedSearch, is_kept: IsKept
    ) -> list[NDArray[np.float64]]:
        """Return paths that keep two levels at each step.

        Independent outages would need the first, one and the same outage the second.
        """
        p_min, count = situation.problem.constraints.p_min, situation.problem.planner.horizon
        every, no_credit = np.ones(count, dtype=np.bool_), np.zeros(count)
        levels = (p_min ** (1.0 / count), p_min)
        return [path for level in levels for path in search(Guide(level, every, no_credit))]

    def missing(
        self, at: Situation, legs_m: NDArray[np.float64], power: Prediction
    ) -> NDArray[np.float64]:
        """Return the missing dB of all steps, as if outages were independent."""
        level = at.problem.constraints.p_min ** (1.0 / legs_m.shape[1])
        return np.maximum(-ways_margins_db(at, legs_m.shape, power, level), 0.0).sum(axis=1)

    def missing_slope(self, at: Situation, batch: WayBatch) -> Pull:
        """Return its derivatives."""
        steps = batch.shape[1]
        level = at.problem.constraints.p_min ** (1.0 / steps)
        return slope_of_missing_db(at, batch, level, np.ones(steps, dtype=np.bool_))

    def is_possible(self, best: BestWithin) -> bool:
        """Return whether the least certain step alone can keep the bound."""
        return bool(best.chances().min() >= best.problem.constraints.p_min)

    def weak_steps(self, problem: Problem, plan: Plan) -> NDArray[np.bool_]:
        """Return the steps below the level that Boole's bound asks of steps that are alike."""
        chance = plan.connectivity[1:]
        return chance < 1.0 - (1.0 - problem.constraints.p_min) / len(chance)


def first_risk(situation: Situation, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Risk allowed to each step of a plan whose steps are bounded together; ``(N,)``.

    Where the path (N, 2) keeps the bound, what its steps risk, grown to what is allowed; else all
    have the same share (Boole).
    """
    problem = situation.problem
    allowed = 1.0 - problem.constraints.p_min
    broad = situation.circumstances.broad
    result = joint_by_slack(problem, situation.posterior, path_m, broad)(0.0)
    if is_missed(result):
        return np.full(len(path_m), min(allowed / len(path_m), LARGEST_RISK))
    used = step_risk(situation, path_m)
    return allocated_again(used, used, allowed, 1.0 - result.achieved)


def step_risk(situation: Situation, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probability of no connection after each step of a path (N, 2); ``(N,)``."""
    power = situation.power(path_m)
    threshold = situation.problem.stations[0].threshold_dbm
    return 1.0 - connection_probability(power.mean_db, power.deviation_db, threshold)
