"""The rule on data delivered by a deadline, in expectation or with probability p_min."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.certificate import RuleResult
from planopt.planning.history import History, data_of_steps_mbit
from planopt.planning.proof.rules.path_draws import DRAWN, drawn_by_slack, require_shown
from planopt.planning.proof.rules.rule import ROUNDING, BySlack, PathCase, Rule
from planopt.problems.problem import Problem


@dataclass(frozen=True)
class Data(Rule):
    """The data delivered keep pace with the deadline (equation 5.4)."""

    kind: ClassVar[str] = "data"
    unit: ClassVar[str] = "Mbit"
    method: ClassVar[str] = "expectation"
    keys: ClassVar[tuple[str, ...]] = ("data_mbit", "deadline_s", "rate_mbit_s")
    asks_p_min: ClassVar[bool] = False
    problem: Problem

    @classmethod
    def of(cls, problem: Problem, legs_m: NDArray[np.float64]) -> Data:
        """Return the rule of a problem."""
        return cls(problem)

    @classmethod
    def keys_fault(cls, given: Collection[str]) -> str | None:
        """Require all keys."""
        for key in cls.keys:
            if key not in given:
                return f'{key} for connectivity = "data": write {key} = 100.0'
        return None

    @classmethod
    def check(cls, problem: Problem) -> None:
        """Raise an InputError for data that no plan could be shown to deliver."""
        rule = problem.constraints.rule
        require_shown(problem, "for data", "leave it out to ask for the expectation")
        most_mbit = (rule.rate_mbit_s or 0.0) * (rule.deadline_s or 0.0)
        if (rule.data_mbit or 0.0) > most_mbit * (1.0 + ROUNDING):
            raise InputError(
                f"is {rule.data_mbit:g}, more than the {most_mbit:g} Mbit that rate_mbit_s "
                "delivers by deadline_s when always connected",
                file=problem.file,
                key="constraints.data_mbit",
                remedy="lessen it, or allow more time",
            )

    def achieved(
        self, probability: NDArray[np.float64], history: History
    ) -> float | NDArray[np.float64]:
        """Return the expected data of the plan."""
        return probability @ data_of_steps_mbit(self.problem, history.steps, probability.shape[-1])

    def required(self, p_min: float, history: History, count: int) -> float:
        """Return the expectation that suffices; for a probability by Markov's inequality."""
        needed = self.pace_mbit(history, count)
        most = float(data_of_steps_mbit(self.problem, history.steps, count).sum())
        return needed if p_min == 0.0 or needed == 0.0 else most - (1.0 - p_min) * (most - needed)

    def pace_mbit(self, history: History, count: int) -> float:
        """Return the data that keep pace: what is missing, spread over the time that is left."""
        rule = self.problem.constraints.rule
        left_s = (rule.deadline_s or 0.0) - history.steps * self.problem.planner.step_s
        missing = max((rule.data_mbit or 0.0) - history.delivered_mbit, 0.0)
        if left_s <= 0.0 or missing == 0.0:
            return 0.0
        most = float(data_of_steps_mbit(self.problem, history.steps, count).sum())
        return missing * most / ((rule.rate_mbit_s or 0.0) * left_s)

    def correlates(self, p_min: float) -> bool:
        """Return whether the verified value is a probability of correlated steps."""
        return p_min > 0.0

    def by_slack(self, case: PathCase) -> BySlack:
        """Return the expectation; or a lower bound of the probability, by correlated samples."""
        p_min = case.problem.constraints.p_min
        if p_min == 0.0:
            return super().by_slack(case)
        # A sum of whole steps may miss its own value by rounding.
        needed = self.pace_mbit(case.history, len(case.positions_m) - 1) * (1.0 - ROUNDING)
        if needed == 0.0:
            return lambda slack_db: RuleResult(self.kind, 1.0, p_min, "probability", DRAWN)
        return drawn_by_slack(
            self,
            case,
            lambda connected: self.valued(connected.astype(np.float64), case.history) >= needed,
        )

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Name the expectation or the probability."""
        if result.unit == self.unit:
            words = "the expected data delivered by the plan"
            return words, "keeping pace with constraints.data_mbit"
        words = "the probability that the plan keeps pace with constraints.data_mbit"
        return words, "constraints.p_min"

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return the data delivered by the deadline."""
        each = [float(data_of_steps_mbit(problem, 0, len(now)) @ now) for now in connected]
        return {"data_mbit": min(each)}
