"""The meaning of each rule of connectivity: the half of a rule by which plans are verified.

Rules on expectations, the average share of connected steps and the data delivered, are here whole.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, bound_margin_db, connection_probability
from planopt.planning.certificate import RuleResult
from planopt.planning.history import History, data_of_steps_mbit
from planopt.planning.proof.predictions import Broad, Serving
from planopt.planning.proof.rules.asked import data_asked_mbit
from planopt.planning.proof.rules.outage import longest_run, outage_result
from planopt.planning.proof.rules.path_draws import joint_by_slack, path_draws_dbm
from planopt.planning.proof.rules.probable_data import probable_data_result
from planopt.problems.constraints import ConnectivityRule
from planopt.problems.problem import Problem


def average_result(
    problem: Problem, history: History, probability: NDArray[np.float64]
) -> RuleResult:
    """Share of the steps of the run so far and the plan that are connected, in expectation."""
    # Shapes: probability (N,).
    connected = history.connected_steps + float(probability.sum())
    steps = history.steps + len(probability)
    return RuleResult(
        "average", connected / steps, problem.constraints.p_min, "probability", "mean"
    )


def data_result(problem: Problem, history: History, probability: NDArray[np.float64]) -> RuleResult:
    """Expected data delivered by the plan before the deadline, and what keeps pace with it.

    Parameters as in :func:`average_result`. An expectation is a sum, however the steps' powers
    belong together.
    """
    each, asked = data_asked_mbit(problem, history, len(probability))
    return RuleResult("data", float(each @ probability), asked, "Mbit", "expectation")


BySlack = Callable[[float], RuleResult]
"""What a path achieves as a function of how many dB lower the threshold is taken."""


@dataclass(frozen=True, eq=False)
class PathCase:
    """A path that is judged by a rule over all its steps."""

    problem: Problem  # What is asked, and what has happened
    history: History
    # What is believed of the channel: rules on steps together need more than `power`
    posterior: ChannelPosterior
    positions_m: NDArray[np.float64]  # (N + 1, 2) the path, the robot's own place first
    power: Prediction  # Prediction at the N places after each step
    broad: Broad | None = None  # The stations, where there are several

    def probability(self, slack_db: float) -> NDArray[np.float64]:
        """Return the probability of connection after each step, (N,), with so much slack."""
        if isinstance(self.broad, Serving) and slack_db > 0.0:
            return self.broad.probability(self.positions_m[1:], slack_db)
        threshold = self.problem.stations[0].threshold_dbm - slack_db
        return connection_probability(self.power.mean_db, self.power.deviation_db, threshold)


class ProvenRule(ABC):
    """The half of a rule by which plans are judged."""

    def asked_steps(self, problem: Problem, history: History, count: int) -> NDArray[np.bool_]:
        """Return whether p_min is asked of each of a plan's steps by itself; ``(count,)``."""
        return np.zeros(count, dtype=np.bool_)

    @abstractmethod
    def by_slack(self, case: PathCase) -> BySlack:
        """Return what a path achieves of a rule over all its steps, by how much slack there is."""

    @abstractmethod
    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Return what a path misses in words, and what asks for more of it."""

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return what a run achieved, of the worst robot, by the name of the metric.

        `connected` has whether each step of each robot ended connected, ``(n,)``.
        """
        return {}


def proven_rule(rule: ConnectivityRule) -> ProvenRule:
    """Return the judging half of the rule that a problem names."""
    found: Any = rule.kind.half(planned=False)
    return found(**dict(rule.settings))


def asked_steps(problem: Problem, history: History, count: int) -> NDArray[np.bool_]:
    """Return whether p_min is asked of each of a plan's `count` steps by itself; ``(count,)``.

    Rules over several steps ask it of none.
    """
    return proven_rule(problem.constraints.rule).asked_steps(problem, history, count)


class EachStep(ProvenRule):
    """p_min at every step."""

    def asked_steps(self, problem: Problem, history: History, count: int) -> NDArray[np.bool_]:
        """Return all steps."""
        return np.ones(count, dtype=np.bool_)

    def by_slack(self, case: PathCase) -> BySlack:
        """Steps are judged one by one, not here."""
        raise AssertionError("a rule on single steps")

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Steps are judged one by one, not here."""
        raise AssertionError("a rule on single steps")


class StatedTimes(EachStep):
    """p_min at the steps that end at stated times."""

    def asked_steps(self, problem: Problem, history: History, count: int) -> NDArray[np.bool_]:
        """Return the steps that end at a stated time."""
        return np.isin(history.steps + 1 + np.arange(count), _stated_steps(problem))

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return the share of the stated times driven through that were connected.

        NaN where there are none.
        """
        stated = np.unique(_stated_steps(problem)).astype(np.intp)
        kept = [now[stated[stated <= len(now)] - 1] for now in connected]
        return {"stated_times_connected": min(_share(now) for now in kept)}


class Average(ProvenRule):
    """The share of connected steps of the run so far and the plan."""

    def by_slack(self, case: PathCase) -> BySlack:
        """Return the expected share."""
        return lambda slack: average_result(case.problem, case.history, case.probability(slack))

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Say which share."""
        return "the share of steps connected on average", "constraints.p_min"

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return the share of connected steps."""
        return {"least_connected_share": min(_share(now) for now in connected)}


class Joint(ProvenRule):
    """The probability that all steps of the plan are connected."""

    def by_slack(self, case: PathCase) -> BySlack:
        """Return a lower bound of the probability."""
        return joint_by_slack(case.problem, case.posterior, case.positions_m[1:], case.broad)

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Say which probability."""
        return "the probability that all steps of the plan are connected", "constraints.p_min"


class Outage(ProvenRule):
    """The longest row of steps below p_min."""

    def by_slack(self, case: PathCase) -> BySlack:
        """Return the longest outage."""
        margin_db = bound_margin_db(
            case.power.mean_db,
            case.power.deviation_db,
            case.problem.stations[0].threshold_dbm,
            case.problem.constraints.p_min,
        )
        return lambda slack_db: outage_result(
            case.problem, case.history, case.positions_m, margin_db + slack_db
        )

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Say that it is the longest outage."""
        return "the longest outage", f"constraints.outage_max_{result.unit}"

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return the longest outage in seconds."""
        step_s = problem.planner.step_s
        each = [longest_run(np.full(len(now), step_s), ~now, 0.0) for now in connected]
        return {"longest_outage_s": max(each) if len(connected[0]) else float("nan")}


class Data(ProvenRule):
    """Data delivered by a deadline: in expectation, or with probability p_min."""

    def by_slack(self, case: PathCase) -> BySlack:
        """Return the expected data, or the probability that they are enough."""
        if case.problem.constraints.p_min > 0.0:
            drawn = path_draws_dbm(case.posterior, case.positions_m[1:], case.broad)
            return lambda slack: probable_data_result(case.problem, case.history, drawn, slack)
        return lambda slack: data_result(case.problem, case.history, case.probability(slack))

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Say whether it is the expectation or the probability."""
        if result.unit == "probability":
            words = "the probability that the plan keeps pace with constraints.data_mbit"
            return words, "constraints.p_min"
        words = "the expected data delivered by the plan"
        return words, "keeping pace with constraints.data_mbit"

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return the data delivered by the deadline."""
        each = [float(data_of_steps_mbit(problem, 0, len(now)) @ now) for now in connected]
        return {"data_mbit": min(each)}


def _stated_steps(problem: Problem) -> NDArray[np.float64]:
    """Numbers of the steps that end at stated times, from 1 on."""
    return np.rint(np.array(problem.constraints.rule.connected_times_s) / problem.planner.step_s)


def _share(connected: NDArray[np.bool_]) -> float:
    return float(connected.mean()) if connected.size else float("nan")
