"""The rule that each step keeps p_min, or each of those that end at stated times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.history import History
from planopt.planning.proof.rules.rule import BySlack, PathCase, Rule, connected_share
from planopt.problems.problem import Problem

WHOLE_STEPS = 1e-6
"""A time is a multiple of the step if it is off by no more than this share of a step."""


@dataclass(frozen=True)
class EachStep(Rule):
    """The probability of each step that counts is at least p_min."""

    kind: ClassVar[str] = "each_step"
    keys: ClassVar[tuple[str, ...]] = ("connected_times_s",)
    by_step: ClassVar[bool] = True
    holds_steps: ClassVar[bool] = True
    stated: tuple[int, ...] = ()  # Steps of the run that count, from 1 on; empty for all

    @classmethod
    def of(cls, problem: Problem, legs_m: NDArray[np.float64]) -> EachStep:
        """Return the rule with the steps that end at the stated times."""
        times_s = np.array(problem.constraints.rule.connected_times_s)
        return cls(tuple(np.rint(times_s / problem.planner.step_s).astype(int).tolist()))

    @classmethod
    def check(cls, problem: Problem) -> None:
        """Raise an InputError for a time at which no step ends."""
        times_s, planner = problem.constraints.rule.connected_times_s, problem.planner
        end_s = max(planner.max_steps, planner.horizon) * planner.step_s
        if min(times_s, default=0.0) > end_s * (1.0 + WHOLE_STEPS):
            raise InputError(
                f"begin with {min(times_s):g}, and a run ends after {end_s:g} s: nothing would be "
                "asked",
                file=problem.file,
                key="constraints.connected_times_s",
                remedy="state earlier times, or raise planner.max_steps",
            )
        for number, time_s in enumerate(times_s):
            steps = time_s / planner.step_s
            if round(steps) < 1 or abs(steps - round(steps)) > WHOLE_STEPS:
                raise InputError(
                    f"is {time_s:g}, which is no multiple of planner.step_s {planner.step_s:g}",
                    file=problem.file,
                    key=f"constraints.connected_times_s[{number}]",
                    remedy="state times at which a step ends",
                )

    def counted(self, history: History, count: int) -> NDArray[np.bool_]:
        """Return whether p_min is required of each of a plan's steps; ``(count,)``."""
        steps = history.steps + 1 + np.arange(count)
        return np.isin(steps, self.stated) if self.stated else np.ones(count, dtype=np.bool_)

    def achieved(
        self, probability: NDArray[np.float64], history: History
    ) -> float | NDArray[np.float64]:
        """Return the least probability of a step that counts; 1 where none does."""
        counted = self.counted(history, probability.shape[-1])
        return np.where(counted, probability, 1.0).min(axis=-1)

    def held(self, keeps: NDArray[np.bool_], history: History) -> NDArray[np.bool_]:
        """Return the steps that count."""
        return self.counted(history, len(keeps))

    def by_slack(self, case: PathCase) -> BySlack:
        """Steps are judged by :mod:`planopt.planning.proof.single_steps`."""
        raise AssertionError("a rule on single steps")

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return the share of the stated times driven through that were connected."""
        if not self.stated:
            return {}
        stated = np.unique(np.array(self.stated))
        kept = [now[stated[stated <= len(now)] - 1] for now in connected]
        return {"stated_times_connected": min(connected_share(now) for now in kept)}


def counted_steps(problem: Problem, history: History, count: int) -> NDArray[np.bool_]:
    """Return whether p_min is required of each of a plan's steps by itself; ``(count,)``."""
    found = problem.constraints.rule.kind.of(problem, np.zeros(count))
    return found.counted(history, count) if isinstance(found, EachStep) else np.zeros(count, bool)
