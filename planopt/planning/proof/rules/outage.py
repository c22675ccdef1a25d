"""The rule on outages: steps below p_min in a row are no longer than stated."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.planning.certificate import RuleResult
from planopt.planning.history import History
from planopt.planning.proof.rules.rule import ROUNDING, BySlack, PathCase, Rule
from planopt.planning.tolerances import RULE_TOLERANCE
from planopt.problems.problem import Problem


@dataclass(frozen=True, eq=False)
class Outage(Rule):
    """The longest outage (equation 5.3), in metres or seconds, is at most the limit."""

    kind: ClassVar[str] = "outage"
    method: ClassVar[str] = "steps below p_min in a row"
    subject: ClassVar[str] = "the longest outage"
    keys: ClassVar[tuple[str, ...]] = ("outage_max_m", "outage_max_s")
    holds_steps: ClassVar[bool] = True
    greatest: ClassVar[bool] = True
    p_min: float
    sizes: NDArray[np.float64]  # (..., N) length or duration of each step
    limit: float
    step_s: float | None = None  # None where lengths count

    @classmethod
    def of(cls, problem: Problem, legs_m: NDArray[np.float64]) -> Outage:
        """Return the rule for these steps."""
        constraints, step_s = problem.constraints, problem.planner.step_s
        rule = constraints.rule
        if rule.outage_max_m is not None:
            return cls(constraints.p_min, legs_m, rule.outage_max_m)
        sizes = np.full(legs_m.shape, step_s)
        return cls(constraints.p_min, sizes, rule.outage_max_s or 0.0, step_s)

    @classmethod
    def keys_fault(cls, given: Collection[str]) -> str | None:
        """Require one of the two keys."""
        if len(set(cls.keys).intersection(given)) == 1:
            return None
        both = " and ".join(cls.keys)
        return f'one of {both} for connectivity = "outage": write outage_max_s = 10.0'

    def _begun(self, history: History) -> float:
        return history.outage_m if self.step_s is None else history.outage_steps * self.step_s

    def achieved(
        self, probability: NDArray[np.float64], history: History
    ) -> float | NDArray[np.float64]:
        """Return the longest outage, negative; one that has begun counts if it goes on."""
        missed = probability < self.p_min - RULE_TOLERANCE
        return -longest_run(self.sizes, missed, self._begun(history))

    def required(self, p_min: float, history: History, count: int) -> float:
        """Return the limit, negative."""
        return -self.limit

    def held(self, keeps: NDArray[np.bool_], history: History) -> NDArray[np.bool_]:
        """Return the fewest steps that end each outage in time, each as late as may be."""
        held = np.zeros(len(keeps), dtype=np.bool_)
        run, last = self._begun(history), -1
        for step, size in enumerate(self.sizes.tolist()):
            run += size
            if run > self.limit * (1.0 + ROUNDING):
                within = np.flatnonzero(keeps[last + 1 : step + 1])
                last = last + 1 + int(within[-1]) if len(within) else step
                held[last] = True
                run = float(self.sizes[last + 1 : step + 1].sum())
        return held

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Name the limit in its unit."""
        return self.subject, f"constraints.outage_max_{result.unit}"

    def by_slack(self, case: PathCase) -> BySlack:
        """Return the longest outage in its unit."""
        result_at, unit = super().by_slack(case), "m" if self.step_s is None else "s"
        return lambda slack_db: replace(result_at(slack_db), unit=unit)

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return the longest outage in seconds."""
        step_s = problem.planner.step_s
        each = [float(longest_run(np.full(len(now), step_s), ~now)) for now in connected]
        return {"longest_outage_s": max(each) if len(connected[0]) else float("nan")}


def longest_run(
    sizes: NDArray[np.float64], missed: NDArray[np.bool_], begun: float = 0.0
) -> NDArray[np.float64]:
    """Return the greatest sum of `sizes` over successive `missed` steps, both (..., N).

    `begun` is added to the run that begins with the first step, if it does.
    """
    longest, run = np.zeros(missed.shape[:-1]), np.full(missed.shape[:-1], begun)
    for step in range(missed.shape[-1]):
        run = np.where(missed[..., step], run + sizes[..., step], 0.0)
        longest = np.maximum(longest, run)
    return longest
