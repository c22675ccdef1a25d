"""Connectivity rules of planopt: each step, average, joint, outage and data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.special import betaincinv

from planopt.arrays import Floats, Mask
from planopt.channel.joint import JointPrediction, longest_run
from planopt.channel.path_connectivity import joint_connectivity
from planopt.errors import InputError
from planopt.planning.certificate import RuleResult
from planopt.planning.plan import History, data_of_steps_mbit, data_pace_mbit
from planopt.planning.proof.rule import ROUNDING, BySlack, PathCase, Rule
from planopt.planning.tolerances import RULE_TOLERANCE
from planopt.problems.problem import Problem

WHOLE_STEPS = 1e-6  # Relative tolerance for a time to be a multiple of the step duration


def _fault(problem: Problem, key: str, words: str, remedy: str) -> InputError:
    """Return the error about a key of [constraints]."""
    return InputError(words, file=problem.file, key=f"constraints.{key}", remedy=remedy)


@dataclass(frozen=True)
class EachStep(Rule):
    """Rule that the connection probability of each constrained step is at least p_min."""

    kind: ClassVar[str] = "each_step"
    keys: ClassVar[tuple[str, ...]] = ("connected_times_s",)
    metric: ClassVar[str] = "stated_times_connected"
    by_step: ClassVar[bool] = True
    holds_steps: ClassVar[bool] = True
    stated: tuple[int, ...] = ()  # Counted steps of the run (1 is the first); empty: all

    @classmethod
    def of(cls, problem: Problem, legs_m: Floats) -> EachStep:
        """Return the rule for the steps that end at the problem's ``connected_times_s``."""
        times_s = np.array(problem.constraints.rule.connected_times_s)
        return cls(tuple(np.rint(times_s / problem.planner.step_s).astype(int).tolist()))

    @classmethod
    def check(cls, problem: Problem) -> None:
        """Raise an InputError for a time that is not the end of a step."""
        times_s, planner = problem.constraints.rule.connected_times_s, problem.planner
        end_s = max(planner.max_steps, planner.horizon) * planner.step_s
        if min(times_s, default=0.0) > end_s * (1.0 + WHOLE_STEPS):
            words = f"has only times from {min(times_s):g} s on, but a run ends after {end_s:g} s"
            remedy = "give earlier times, or increase planner.max_steps"
            raise _fault(problem, "connected_times_s", words, remedy)
        for number, time_s in enumerate(times_s):
            steps = time_s / planner.step_s
            if round(steps) < 1 or abs(steps - round(steps)) > WHOLE_STEPS:
                words = f"is {time_s:g} s, which is not a multiple of planner.step_s "
                words += f"({planner.step_s:g} s)"
                remedy = "give times at which a step ends"
                raise _fault(problem, f"connected_times_s[{number}]", words, remedy)

    def counted(self, history: History, count: int) -> Mask:
        """Return a mask (count,) of the plan's steps for which p_min is required."""
        steps = history.steps + 1 + np.arange(count)
        return np.isin(steps, self.stated) if self.stated else np.ones(count, dtype=np.bool_)

    def achieved(self, probability: Floats, history: History) -> float | Floats:
        """Return the minimum probability of the constrained steps; 1 if there are none."""
        counted = self.counted(history, probability.shape[-1])
        return np.where(counted, probability, 1.0).min(axis=-1)

    def held(self, keeps: Mask, history: History) -> Mask:
        """Return a mask of the steps for which p_min is required."""
        return self.counted(history, len(keeps))

    def by_slack(self, case: PathCase) -> BySlack:
        """Raise an AssertionError: single steps are verified elsewhere."""
        raise AssertionError("a rule on single steps")

    def run_metrics(self, problem: Problem, connected: Sequence[Mask]) -> dict[str, float]:
        """Return the connected fraction of the stated times as a metric; empty without times."""
        return super().run_metrics(problem, connected) if self.stated else {}

    def over_run(self, problem: Problem, connected: Mask) -> float:
        """Return the connected fraction of the stated times that have passed."""
        stated = np.unique(np.array(self.stated))
        return super().over_run(problem, connected[stated[stated <= len(connected)] - 1])


@dataclass(frozen=True)
class Average(Rule):
    """Rule that the expected fraction of connected steps is >= p_min (equation 5.1)."""

    kind: ClassVar[str] = "average"
    method: ClassVar[str] = "mean"
    subject: ClassVar[str] = "the share of steps connected on average"
    metric: ClassVar[str] = "least_connected_share"

    def achieved(self, probability: Floats, history: History) -> float | Floats:
        """Return the expected fraction of connected steps."""
        steps = history.steps + probability.shape[-1]
        return (history.connected_steps + probability.sum(axis=-1)) / steps


DRAWS, SEED = 10_000, 0
"""Number of sampled channels, and seed of the samples and of the integral's random shifts."""
DOUBT = 0.01  # One-sided error probability of the confidence interval (Clopper, Pearson 1934)
DRAWN = f"{DRAWS} drawn channels, lower end of the {100.0 * (1.0 - DOUBT):.0f} % interval"
"""Name of the sampling method."""
MOST_PROBABLE = 0.9995  # Largest p_min that the sampled channels can demonstrate


def _require_shown(problem: Problem, words: str, remedy: str) -> None:
    """Raise an InputError if p_min exceeds the largest value that sampling can verify."""
    p_min = problem.constraints.p_min
    if p_min > MOST_PROBABLE:
        words = f"is {p_min:g}, but at most {MOST_PROBABLE:g} can be verified {words}"
        raise _fault(problem, "p_min", words, f"reduce it, or {remedy}")


def share_at_least(count: int, of: int) -> float:
    """Return the lower confidence limit of a probability after `count` events in `of` trials."""
    if count == 0:
        return 0.0
    return float(np.asarray(betaincinv(count, of - count + 1, DOUBT), dtype=np.float64))


def drawn_by_slack(rule: Rule, case: PathCase, least: float) -> BySlack:
    """Return a function that maps slack to a lower bound of P(value >= `least`), by sampling."""
    drawn_dbm = case.context.law.sample(case.positions_m[1:], DRAWS, SEED)
    threshold, p_min = case.problem.stations[0].threshold_dbm, case.problem.constraints.p_min

    def result(slack_db: float) -> RuleResult:
        connected = (drawn_dbm >= threshold - slack_db).astype(np.float64)
        kept = int((rule.valued(connected, case.history) >= least).sum())
        achieved = share_at_least(kept, DRAWS) if least > 0.0 else 1.0
        return RuleResult(rule.kind, achieved, p_min, "probability", DRAWN)

    return result


ACCURACY = 4e-3  # Target accuracy of the integral (three standard errors)
INTEGRATED_STEPS = 60
"""Maximum number of steps for the integral; beyond it, an analytic lower bound is used."""


@dataclass(frozen=True)
class Joint(Rule):
    """Rule that the probability of connection at all steps is >= p_min (equation 5.2)."""

    kind: ClassVar[str] = "joint"
    subject: ClassVar[str] = "the probability that all steps of the plan are connected"
    is_joint: ClassVar[bool] = True

    @classmethod
    def check(cls, problem: Problem) -> None:
        """Raise an InputError if sampling of several stations cannot verify p_min."""
        if len(problem.stations) > 1:
            words = f"over all steps jointly with {len(problem.stations)} stations"
            _require_shown(problem, words, "keep only one entry of stations")

    def achieved(self, probability: Floats, history: History) -> float | Floats:
        """Return Boole's lower bound (negative if useless) of the joint probability."""
        return 1.0 - (1.0 - probability).sum(axis=-1)

    def by_slack(self, case: PathCase) -> BySlack:
        """Return a function that maps slack to a lower bound of the joint probability."""
        problem, path_m = case.problem, case.positions_m[1:]
        threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min
        if len(case.context.posteriors) == 1:
            (prediction,) = case.context.law.along(path_m)
            return lambda slack_db: joint_result(prediction, threshold - slack_db, p_min)
        return drawn_by_slack(self, case, least=1.0)


def joint_result(prediction: JointPrediction, threshold_dbm: float, p_min: float) -> RuleResult:
    """Return the joint rule's result, with the best lower bound of the joint probability."""
    found = joint_connectivity(prediction, threshold_dbm)
    # If a single step already violates the bound, no integral is needed.
    if len(prediction) <= INTEGRATED_STEPS and found.at_each.min() >= p_min:
        generator = np.random.default_rng(SEED)
        found = joint_connectivity(prediction, threshold_dbm, generator, ACCURACY)
    bounds = {
        "Hunter's bound": found.hunter.value,
        "Slepian's product": found.product.value,
        "corrected product": found.corrected_product.value,
        "Boole's bound": found.boole.value,
    }
    if found.exact is not None:
        bounds["integral less three standard errors"] = found.exact.value - found.exact.error
    proven = {method: value for method, value in bounds.items() if value is not None}
    best = max(proven, key=lambda method: proven[method])
    return RuleResult(Joint.kind, proven[best], p_min, Joint.unit, best)


@dataclass(frozen=True, eq=False)
class Outage(Rule):
    """Rule that the longest outage (equation 5.3), in metres or seconds, is below the limit."""

    kind: ClassVar[str] = "outage"
    method: ClassVar[str] = "steps below p_min in a row"
    subject: ClassVar[str] = "the longest outage"
    metric: ClassVar[str] = "longest_outage_s"
    keys: ClassVar[tuple[str, ...]] = ("outage_max_m", "outage_max_s")
    keys_required: ClassVar[int] = 1
    holds_steps: ClassVar[bool] = True
    greatest: ClassVar[bool] = True
    p_min: float
    sizes: Floats  # (..., N) length or duration of each step
    limit: float
    step_s: float | None = None  # Step duration; None for an outage in metres

    @classmethod
    def of(cls, problem: Problem, legs_m: Floats) -> Outage:
        """Return the rule for steps of lengths `legs_m`."""
        p_min, rule, step_s = problem.constraints.p_min, problem.constraints.rule, None
        if rule.outage_max_m is None:
            legs_m, step_s = np.full(legs_m.shape, problem.planner.step_s), problem.planner.step_s
        return cls(p_min, legs_m, rule.outage_max_m or rule.outage_max_s or 0.0, step_s)

    def _begun(self, history: History) -> float:
        return history.outage_m if self.step_s is None else history.outage_steps * self.step_s

    def achieved(self, probability: Floats, history: History) -> float | Floats:
        """Return the negative of the longest outage, including an outage in progress."""
        below = probability < self.p_min - RULE_TOLERANCE
        return -longest_run(self.sizes, below, self._begun(history))

    def required(self, p_min: float, history: History, count: int) -> float:
        """Return the negative of the outage limit."""
        return -self.limit

    def held(self, keeps: Mask, history: History) -> Mask:
        """Return a mask of few, late steps whose connection keeps every outage within the limit."""
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

    def by_slack(self, case: PathCase) -> BySlack:
        """Return a function that maps slack to the longest outage, in metres or seconds."""
        result_at, unit = super().by_slack(case), "m" if self.step_s is None else "s"
        return lambda slack_db: replace(result_at(slack_db), unit=unit)

    def over_run(self, problem: Problem, connected: Mask) -> float:
        """Return the longest outage of the run so far, in seconds."""
        longest = longest_run(np.full(len(connected), problem.planner.step_s), ~connected)
        return float(longest) if len(connected) else float("nan")


@dataclass(frozen=True)
class Data(Rule):
    """Rule that the required data are delivered by the deadline (equation 5.4)."""

    kind: ClassVar[str] = "data"
    unit: ClassVar[str] = "Mbit"
    method: ClassVar[str] = "expectation"
    subject: ClassVar[str] = "the probability that the plan keeps pace with constraints.data_mbit"
    metric: ClassVar[str] = "data_mbit"
    keys: ClassVar[tuple[str, ...]] = ("data_mbit", "deadline_s", "rate_mbit_s")
    keys_required: ClassVar[int] = 3
    uses_p_min: ClassVar[bool] = False
    is_joint: ClassVar[bool] = True
    problem: Problem

    @classmethod
    def of(cls, problem: Problem, legs_m: Floats) -> Data:
        """Return the data rule of a problem for plans."""
        return cls(problem)

    @classmethod
    def check(cls, problem: Problem) -> None:
        """Raise an InputError for more data than a permanent connection can deliver in time."""
        _require_shown(problem, "for data", "leave it out to constrain the expected amount")
        rule = problem.constraints.rule
        most_mbit = (rule.rate_mbit_s or 0.0) * (rule.deadline_s or 0.0)
        if (rule.data_mbit or 0.0) > most_mbit * (1.0 + ROUNDING):
            words = f"is {rule.data_mbit:g}, more than the {most_mbit:g} Mbit that rate_mbit_s "
            words += "delivers by deadline_s when always connected"
            remedy = "reduce it, or increase constraints.deadline_s or constraints.rate_mbit_s"
            raise _fault(problem, "data_mbit", words, remedy)

    def achieved(self, probability: Floats, history: History) -> float | Floats:
        """Return the expected data delivered by the plan."""
        return probability @ data_of_steps_mbit(self.problem, history.steps, probability.shape[-1])

    def required(self, p_min: float, history: History, count: int) -> float:
        """Return the expected data that p_min requires of a plan, by Markov's inequality."""
        needed = data_pace_mbit(self.problem, history, count)
        most = float(data_of_steps_mbit(self.problem, history.steps, count).sum())
        return needed if p_min == 0.0 or needed == 0.0 else most - (1.0 - p_min) * (most - needed)

    def by_slack(self, case: PathCase) -> BySlack:
        """Return a function that maps slack to expected data or a lower bound on P(delivery)."""
        if case.problem.constraints.p_min == 0.0:
            return super().by_slack(case)
        needed = data_pace_mbit(self.problem, case.history, len(case.positions_m) - 1)
        # The sum over whole steps may differ from the requirement by rounding.
        return drawn_by_slack(self, case, needed * (1.0 - ROUNDING))

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Return text on the achieved data or probability, and on the required value."""
        if result.unit != self.unit:
            return super().missed_words(result)
        return "the expected data delivered by the plan", "keeping pace with constraints.data_mbit"

    def over_run(self, problem: Problem, connected: Mask) -> float:
        """Return the data that the run delivered by the deadline."""
        return float(data_of_steps_mbit(problem, 0, len(connected)) @ connected)
