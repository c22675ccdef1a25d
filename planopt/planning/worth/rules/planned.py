"""The half of a rule of connectivity by which plans are sought.

As rows that a solver can keep about a start path: bounds on single steps, each at a probability of
its own, or one bound on a sum over the steps. As guides of a search over a lattice, where rewards
add up: bounds on steps, and credit for chances. And as a measure of what many ways lack.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import (
    Prediction,
    bound_margin_db,
    bound_quantile,
    connection_probability,
)
from planopt.objectives.told_batch import Pull, WayBatch, pull_of_power
from planopt.planning.plan import Plan
from planopt.planning.proof.rules.proven import ProvenRule, proven_rule
from planopt.planning.worth.situation import Situation
from planopt.problems.constraints import ConnectivityRule
from planopt.problems.problem import Problem

UNASKED = 0.5
"""Level of a step that nothing is asked of: its row is there, without a bound."""


@dataclass(frozen=True, eq=False)
class RuleRows:
    """The rows of the rule for a path of N steps."""

    threshold_dbm: float  # Power from which on a place is connected
    level: NDArray[np.float64]  # (N,) probability asked of each step
    asked: NDArray[np.bool_]  # (N,) whether it is
    # (N,) of the sum of the probabilities; None where no sum is bounded
    weight: NDArray[np.float64] | None = None
    total: float = 0.0  # What the sum must reach

    @property
    def quantile(self) -> NDArray[np.float64]:
        """``(N,)`` z_p of each step's level."""
        return np.array([bound_quantile(level) for level in self.level.tolist()])

    def margins_db(self, power: Prediction) -> NDArray[np.float64]:
        """Margins of each step at its own level; infinite where nothing is asked."""
        margins = power.mean_db - self.quantile * power.deviation_db - self.threshold_dbm
        return np.where(self.asked, margins, np.inf)

    def sum_of(self, power: Prediction) -> float:
        """The sum at predicted powers."""
        if self.weight is None:
            raise AssertionError("no sum is bounded")
        chance = connection_probability(power.mean_db, power.deviation_db, self.threshold_dbm)
        return float(self.weight @ chance)


def held_rows(problem: Problem, asked: NDArray[np.bool_]) -> RuleRows:
    """Ask p_min of some steps (N,)."""
    level = np.where(asked, problem.constraints.p_min, UNASKED)
    return RuleRows(problem.stations[0].threshold_dbm, level, asked)


@dataclass(frozen=True, eq=False)
class Guide:
    """The steps, level and credits that a search minds."""

    level: float  # Probability that the steps asked for must keep
    asked: NDArray[np.bool_]  # (N,) which these are
    # (N,) what a connection is worth at each step, in units of the largest reward of a step; its
    # chance counts
    credit: NDArray[np.float64]


GuidedSearch = Callable[[Guide], list[NDArray[np.float64]]]
"""From a guide to the best paths (N, 2), best first."""

IsKept = Callable[[NDArray[np.float64]], bool]
"""Whether a path (N, 2) keeps the rule."""


@dataclass(frozen=True)
class BestWithin:
    """The best that there is within reach by each of N steps from the start of a run."""

    problem: Problem  # With thresholds as much lower as slack and the search's grid allow
    # Give (N,) margins of p_min, and probabilities of connection
    margins_db: Callable[[], NDArray[np.float64]]
    chances: Callable[[], NDArray[np.float64]]


@dataclass(frozen=True)
class PlannedRule(ABC):
    """The half of a rule by which plans are sought."""

    proven: ProvenRule  # The other half
    bounds_sum: ClassVar[bool] = False  # Whether a sum over the steps is bounded, not single steps
    # Whether a risk is allocated to the steps, and again after a polish
    allocates: ClassVar[bool] = False
    # Whether more steps than the horizon's may make it easier to keep
    more_steps: ClassVar[bool] = True

    @abstractmethod
    def rows(self, situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
        """Return the rows for a polish that starts from `path_m` (N, 2)."""

    @abstractmethod
    def find_guided(
        self, situation: Situation, search: GuidedSearch, is_kept: IsKept
    ) -> list[NDArray[np.float64]]:
        """Return paths (N, 2) of a search under the guides that suit the rule."""

    @abstractmethod
    def missing(
        self, at: Situation, legs_m: NDArray[np.float64], power: Prediction
    ) -> NDArray[np.float64]:
        """Return a measure of what each way lacks, 0 where it keeps the rule; ``(c,)``."""
        # Shapes: legs_m (c, N).

    def missing_slope(self, at: Situation, batch: WayBatch) -> Pull:
        """Return the derivatives of :meth:`missing` where that adds up dB.

        Nothing for rules that count otherwise: a way then climbs as if there were none, but no step
        that misses more is taken.
        """
        return Pull()

    @abstractmethod
    def is_possible(self, best: BestWithin) -> bool:
        """Return whether the best place within reach by each step does not rule the rule out."""

    @abstractmethod
    def weak_steps(self, problem: Problem, plan: Plan) -> NDArray[np.bool_]:
        """Return the steps (N,) by which a plan misses a rule over the whole plan."""


def planned_rule(rule: ConnectivityRule) -> PlannedRule:
    """Return the planning half of the rule that a problem names."""
    found: Any = rule.kind.half(planned=True)
    return found(proven_rule(rule))


def has_step_rows(problem: Problem) -> bool:
    """Return whether single steps are bounded."""
    return problem.constraints.asks_connection and not has_sum_row(problem)


def has_sum_row(problem: Problem) -> bool:
    """Return whether a sum over the steps is bounded."""
    return planned_rule(problem.constraints.rule).bounds_sum


LEAST_LEVEL = 1e-3
"""A step of a sum that may be less certain than this is not bounded; none must be more certain than
one less this."""


def rule_rows(situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
    """The rows for a polish that starts from `path_m` (N, 2)."""
    return planned_rule(situation.problem.constraints.rule).rows(situation, path_m)


def step_rows(situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
    """The rows of a programme that bounds single steps only, about a path (N, 2).

    A bound on a sum becomes one on each of its steps: what the path has to spare, or lacks, is
    spread evenly over them.
    """
    rows = rule_rows(situation, path_m)
    if rows.weight is None:
        return rows
    power = situation.power(path_m)
    chance = connection_probability(power.mean_db, power.deviation_db, rows.threshold_dbm)
    spare = (rows.sum_of(power) - rows.total) / max(float(rows.weight.sum()), 1e-9)
    level = chance - spare
    asked = (rows.weight > 0.0) & (level > LEAST_LEVEL)
    level = np.clip(level, LEAST_LEVEL, 1.0 - LEAST_LEVEL)
    return RuleRows(rows.threshold_dbm, np.where(asked, level, UNASKED), asked)


def ways_margins_db(
    at: Situation, shape: tuple[int, ...], power: Prediction, level: float
) -> NDArray[np.float64]:
    """Margins of a level at the places of ways, ``(c, N)``."""
    threshold = at.problem.stations[0].threshold_dbm
    return bound_margin_db(power.mean_db, power.deviation_db, threshold, level).reshape(shape)


def ways_chances(at: Situation, shape: tuple[int, ...], power: Prediction) -> NDArray[np.float64]:
    """Probabilities of connection at the places of ways, ``(c, N)``."""
    threshold = at.problem.stations[0].threshold_dbm
    return connection_probability(power.mean_db, power.deviation_db, threshold).reshape(shape)


def slope_of_missing_db(
    at: Situation, batch: WayBatch, level: float, asked: NDArray[np.bool_]
) -> Pull:
    """Derivatives of the dB that ways miss a level by at the steps asked for (N,), summed."""
    power, quantile = batch.power, bound_quantile(level)
    margin = power.mean_db - quantile * power.deviation_db - at.problem.stations[0].threshold_dbm
    missed = ((margin < 0.0).reshape(batch.shape) & asked).astype(np.float64)
    return pull_of_power(batch, -missed, quantile * missed)
