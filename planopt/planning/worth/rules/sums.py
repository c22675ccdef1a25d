"""Plans that keep a bound on a sum of chances: an average, expected data, a rule of one's own."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.history import BEGINNING, History
from planopt.planning.plan import Plan
from planopt.planning.proof.rules.asked import connected_steps_asked, data_asked_mbit
from planopt.planning.proof.rules.own import OwnRule
from planopt.planning.worth.path_worth import rule_missing
from planopt.planning.worth.rules.planned import (
    UNASKED,
    BestWithin,
    Guide,
    GuidedSearch,
    IsKept,
    PlannedRule,
    RuleRows,
    ways_chances,
)
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem

HIGHEST_CREDIT, LOWEST_CREDIT = 10.0, 1e-3
"""Credit of a connected step, in units of the largest reward of a step: with the first no other
reward counts, with the second hardly the credit."""

HALVINGS = 5
"""Bisections of the credit between them, in its logarithm."""

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99)
"""Of every step, tried for rules of one's own until one is enough."""


class _PlannedSum(PlannedRule):
    """A bound on a sum over the steps."""

    bounds_sum: ClassVar[bool] = True

    @abstractmethod
    def total_asked(
        self, problem: Problem, history: History, chance: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return weights (N,) of the chances of N steps, and what their sum must reach.

        Near `chance` (N,), where what is asked is no sum.
        """

    def rows(self, situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
        """Return one bound on the sum."""
        problem, count = situation.problem, len(path_m)
        power, threshold = situation.power(path_m), problem.stations[0].threshold_dbm
        chance = connection_probability(power.mean_db, power.deviation_db, threshold)
        weight, total = self.total_asked(problem, situation.circumstances.history, chance)
        none = np.zeros(count, dtype=np.bool_)
        return RuleRows(threshold, np.full(count, UNASKED), none, weight, total)

    def find_guided(
        self, situation: Situation, search: GuidedSearch, is_kept: IsKept
    ) -> list[NDArray[np.float64]]:
        """Return paths under a credit as small as may be: a Lagrange multiplier, by bisection."""
        problem, count = situation.problem, situation.problem.planner.horizon
        history = situation.circumstances.history
        weight, _ = self.total_asked(problem, history, np.full(count, UNASKED))
        weight = weight / max(float(weight.max()), 1e-9)
        none = Guide(0.0, np.zeros(count, dtype=np.bool_), np.zeros(count))
        found = search(none)
        if not found or is_kept(found[0]):
            return found
        low, high = LOWEST_CREDIT, HIGHEST_CREDIT
        most = search(replace(none, credit=high * weight))
        found += most
        if not most or not is_kept(most[0]):
            return found
        for _ in range(HALVINGS):
            middle = float(np.sqrt(low * high))
            paths = search(replace(none, credit=middle * weight))
            found += paths
            low, high = (low, middle) if paths and is_kept(paths[0]) else (middle, high)
        return found

    def missing(
        self, at: Situation, legs_m: NDArray[np.float64], power: Prediction
    ) -> NDArray[np.float64]:
        """Return by how much the sum falls short."""
        chance = ways_chances(at, legs_m.shape, power)
        each, asked = self.total_asked(at.problem, at.circumstances.history, chance[0])
        return np.maximum(asked - chance @ each, 0.0)


class PlannedAverage(_PlannedSum):
    """The average share of connected steps."""

    def total_asked(
        self, problem: Problem, history: History, chance: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return how many of the steps must be connected."""
        return np.ones(len(chance)), connected_steps_asked(problem, history, len(chance))

    def is_possible(self, best: BestWithin) -> bool:
        """Return whether the best chances are enough on average."""
        return bool(best.chances().mean() >= best.problem.constraints.p_min)

    def weak_steps(self, problem: Problem, plan: Plan) -> NDArray[np.bool_]:
        """Return the steps below p_min."""
        return plan.connectivity[1:] < problem.constraints.p_min


class PlannedData(_PlannedSum):
    """Data delivered by a deadline."""

    def total_asked(
        self, problem: Problem, history: History, chance: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return what each step delivers, and the data that keep pace."""
        return data_asked_mbit(problem, history, len(chance))

    def rows(self, situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
        """Return one bound on the expected data.

        Of a start that keeps a probability, what is expected of it is enough, or nearly so.
        """
        rows = super().rows(situation, path_m)
        asks = situation.problem.constraints.p_min > 0.0
        if not asks or rule_missing(situation, path_m) > 0.0:
            return rows
        return replace(rows, total=max(rows.total, rows.sum_of(situation.power(path_m))))

    def is_possible(self, best: BestWithin) -> bool:
        """Return whether the best chances deliver enough.

        By Markov's inequality, where a probability is asked.
        """
        chance = best.chances()
        each, asked = data_asked_mbit(best.problem, BEGINNING, len(chance))
        return float(each @ chance) >= asked * (best.problem.constraints.p_min or 1.0)

    def weak_steps(self, problem: Problem, plan: Plan) -> NDArray[np.bool_]:
        """Return the steps that deliver less than all would have to, were they alike."""
        chance = plan.connectivity[1:]
        each, total = data_asked_mbit(problem, BEGINNING, len(chance))
        share = total / max(float(each.sum()), 1e-9)
        return chance < np.where(each > 0.0, max(problem.constraints.p_min, share), 0.0)


class PlannedOwn(_PlannedSum):
    """A rule of one's own, by its slopes at the chances of a path."""

    @property
    def _own(self) -> OwnRule:
        return cast("OwnRule", self.proven)

    def total_asked(
        self, problem: Problem, history: History, chance: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return the tangent of what is achieved."""
        achieved, slope = self._own.slopes(chance, history)
        asked = self._own.asked_value(problem.constraints.p_min)
        return slope, asked - achieved + float(slope @ chance)

    def find_guided(
        self, situation: Situation, search: GuidedSearch, is_kept: IsKept
    ) -> list[NDArray[np.float64]]:
        """Return paths under credits, and where none keeps the rule, those that keep levels.

        A rule that looks at the weakest of steps is met by a level at each, not by a sum.
        """
        found = super().find_guided(situation, search, is_kept)
        if any(is_kept(path) for path in found):
            return found
        count = situation.problem.planner.horizon
        every, no_credit = np.ones(count, dtype=np.bool_), np.zeros(count)
        for level in LEVELS:
            paths = search(Guide(level, every, no_credit))
            found += paths
            if paths and is_kept(paths[0]):
                break
        return found

    def missing(
        self, at: Situation, legs_m: NDArray[np.float64], power: Prediction
    ) -> NDArray[np.float64]:
        """Return by how much what is achieved falls short."""
        chance = ways_chances(at, legs_m.shape, power)
        achieved = self._own.valued(chance, at.circumstances.history)
        return np.maximum(self._own.asked_value(at.problem.constraints.p_min) - achieved, 0.0)

    def is_possible(self, best: BestWithin) -> bool:
        """Return whether the best chances achieve enough."""
        achieved = self._own.valued(best.chances(), BEGINNING)
        return bool(achieved >= self._own.asked_value(best.problem.constraints.p_min))

    def weak_steps(self, problem: Problem, plan: Plan) -> NDArray[np.bool_]:
        """Return the steps that are less certain than the plan's median."""
        chance = plan.connectivity[1:]
        return chance <= np.median(chance)
