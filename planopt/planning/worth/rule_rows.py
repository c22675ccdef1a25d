"""The rule of connectivity as rows that a solver can keep, about a start path.

Bounds on single steps, each at a probability of its own, or one bound on a sum over the steps. The
rules on outages and on all steps together are not of that form: the steps that the start path holds
are held, and the allowed risk is allocated to the steps (equation 5.6).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_quantile, connection_probability
from planopt.planning.proof.rules.asked import (
    asked_steps,
    connected_steps_asked,
    data_asked_mbit,
)
from planopt.planning.proof.rules.path_draws import joint_by_slack
from planopt.planning.proof.rules.tolerance import is_missed
from planopt.planning.worth.held_steps import held_steps
from planopt.planning.worth.risk_allocation import LARGEST_RISK, allocated_again
from planopt.planning.worth.rule_worth import rule_missing
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem

UNASKED = 0.5
"""Level of a step that nothing is asked of: its row is there, without a bound."""


LEAST_LEVEL = 1e-3
"""A step of a sum that may be less certain than this is not bounded; none must be more certain than
one less this."""


@dataclass(frozen=True, eq=False)
class RuleRows:
    """What is asked of a path of N steps.

    Attributes
    ----------
    threshold_dbm
        Power from which on a place is connected.
    level
        ``(N,)`` probability asked of each step.
    asked
        ``(N,)`` whether it is.
    weight
        ``(N,)`` of the sum of the probabilities; None where no sum is bounded.
    total
        What the sum must reach.
    """

    threshold_dbm: float
    level: NDArray[np.float64]
    asked: NDArray[np.bool_]
    weight: NDArray[np.float64] | None = None
    total: float = 0.0

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


def has_step_rows(problem: Problem) -> bool:
    """Whether single steps are bounded."""
    return problem.constraints.asks_connection and not has_sum_row(problem)


def has_sum_row(problem: Problem) -> bool:
    """Whether a sum over the steps is bounded."""
    return problem.constraints.rule.connectivity in ("average", "data")


def rule_rows(situation: Situation, path_m: NDArray[np.float64]) -> RuleRows:
    """The rows for a polish that starts from `path_m` (N, 2)."""
    problem, history = situation.problem, situation.circumstances.history
    constraints, count = problem.constraints, len(path_m)
    threshold = problem.stations[0].threshold_dbm
    none = np.zeros(count, dtype=bool)
    match constraints.rule.connectivity:
        case "each_step" | "stated_times":
            asked = asked_steps(problem, history, count) & constraints.asks_connection
            return _held(threshold, constraints.p_min, asked)
        case "outage":
            return _held(threshold, constraints.p_min, held_steps(situation, path_m))
        case "joint":
            return RuleRows(threshold, 1.0 - first_risk(situation, path_m), ~none)
        case "average":
            total = connected_steps_asked(problem, history, count)
            return RuleRows(threshold, np.full(count, UNASKED), none, np.ones(count), total)
        case "data":
            each, total = data_asked_mbit(problem, history, count)
            rows = RuleRows(threshold, np.full(count, UNASKED), none, each, total)
            if constraints.p_min > 0.0 and rule_missing(situation, path_m) == 0.0:
                # What is expected of the start is enough to keep its probability, or nearly so.
                expected = rows.sum_of(situation.power(path_m))
                return replace(rows, total=max(total, expected))
            return rows


def _held(threshold_dbm: float, level: float, asked: NDArray[np.bool_]) -> RuleRows:
    return RuleRows(threshold_dbm, np.where(asked, level, UNASKED), asked)


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
