"""Objective value of a path: the weighted sum of its terms, from all measurements.

Plans are compared by this value, and results report it. Solvers use the differentiable local
approximation in :mod:`planopt.planning.values.local_value`. Violations of the connectivity rule and
their slack are penalised in addition.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import connection_probability
from planopt.errors import InputError
from planopt.objectives.terms.term import Term
from planopt.parts import calling, returned
from planopt.planning.certificate import RuleResult
from planopt.planning.proof.rule import PathCase, rule_of, whole_plan_result
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB, margins_asked_db
from planopt.planning.values.context import StepContext
from planopt.robots.dynamics import Drive


@dataclass(frozen=True)
class ObjectiveValue:
    """Objective value of paths in one step context."""

    context: StepContext

    def __call__(self, path_m: NDArray[np.float64], drive: Drive | None = None) -> float:
        """Return the weighted sum of the terms for a path (N, 2), minus the cost of its slack."""
        del drive  # terms depend on positions alone
        return float(sum(self.by_term(path_m))) - slack_cost(self.context, path_m)

    def by_term(self, path_m: NDArray[np.float64]) -> tuple[float, ...]:
        """Return the contribution of each term of the objective, its weight included."""
        return tuple(self._contributed(number, path_m) for number in range(len(self._terms)))

    def of_each(self, paths_m: Sequence[NDArray[np.float64]]) -> list[float]:
        """Return the objective value of several paths, predicted jointly."""
        for path in paths_m:
            self.context.soon(path)
        total = np.zeros(len(paths_m))
        for number in range(len(self._terms)):
            total += self._of_term(number, paths_m)
        return [
            value - slack_cost(self.context, path)
            for value, path in zip(total.tolist(), paths_m, strict=True)
        ]

    def _of_term(self, number: int, paths_m: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the contribution of one term to several paths; ``(c,)``."""
        term, at = self._terms[number], self.context
        if not term.probes_end or not paths_m:
            return np.array([self._contributed(number, path) for path in paths_m])
        paths = np.array(paths_m)
        power = at.power(paths.reshape(-1, 2))
        chance = connection_probability(power.mean_db, power.deviation_db, at.thresholds_dbm[0])
        return probe_values(at, number, paths, chance.reshape(paths.shape[:2]))

    @property
    def _terms(self) -> tuple[Term, ...]:
        return self.context.problem.terms

    def _contributed(self, number: int, path_m: NDArray[np.float64]) -> float:
        term = self._terms[number]
        with _named(self.context, number):
            with calling(term, "value", key="value"):
                value = term.value(self.context, path_m)
            words = "one finite number"
            return term.weight * float(returned(term, "value", value, (), words=words, key="value"))


def probe_values(
    at: StepContext, number: int, paths_m: NDArray[np.float64], chance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the weighted contribution of a term that probes path ends; ``(c,)``."""
    # Shapes: paths_m (c, N, 2); chance (c, N).
    term, method = at.problem.terms[number], "probe_values"
    words = "one finite number for each path"
    with _named(at, number):
        with calling(term, method, key=method):
            found = term.probe_values(at, paths_m, chance)
        return term.weight * returned(term, method, found, (len(paths_m),), words=words, key=method)


@contextmanager
def _named(at: StepContext, number: int) -> Generator[None]:
    """Add the term's name to errors."""
    try:
        yield
    except InputError as error:
        if error.key is None or error.key.startswith("objective"):
            raise
        raise error.under(f"objective.terms[{number}]").located(at.problem.file) from error


SHARE_IN_DB = 100.0
"""Cost in dB of a rule over a whole plan that is violated entirely."""


def slack_cost(at: StepContext, path_m: NDArray[np.float64]) -> float:
    """Return the cost of the slack of a path (N, 2), in the objective's unit."""
    rule = at.problem.constraints.rule
    if rule.slack_price == 0.0:
        return 0.0
    if rule.by_step:
        return rule.slack_price * float(_missed_db(at, path_m).sum())
    result = rule_result(at, path_m)
    beyond = result.slack_db == 0.0 and result.is_missed
    return rule.slack_price * ((rule.slack_max_db or 0.0) if beyond else result.slack_db)


def rule_missing(at: StepContext, path_m: NDArray[np.float64]) -> float:
    """Return the rule's violation by a path (N, 2) beyond its slack; 0 if it is satisfied.

    The unit is dB, summed over steps. For a rule over a whole plan it is the relative shortfall
    times `SHARE_IN_DB`.
    """
    constraints = at.problem.constraints
    if not constraints.asks_connection:
        return 0.0
    if constraints.rule.by_step:
        missed = _missed_db(at, path_m) - (constraints.rule.slack_max_db or 0.0)
        return float(missed[missed > MARGIN_TOLERANCE_DB].sum())
    result = rule_result(at, path_m)
    if result.slack_db > 0.0 or not result.is_missed:
        return 0.0
    return SHARE_IN_DB * result.missing / max(result.asked, 1.0)


def _missed_db(at: StepContext, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the violation of the bound at each constrained step; (N,)."""
    power, problem = at.power(path_m), at.problem
    margins = margins_asked_db(problem, power)
    missed = margins < -MARGIN_TOLERANCE_DB
    asked = rule_of(problem).counted(at.history, len(path_m))
    return np.where(missed & asked, -margins, 0.0)


def rule_result(at: StepContext, path_m: NDArray[np.float64]) -> RuleResult:
    """Return the verifier's result of a path (N, 2) for a rule over the whole plan."""
    places_m = np.vstack([at.position_m, path_m])
    return whole_plan_result(PathCase(at, places_m, at.power(path_m)))
