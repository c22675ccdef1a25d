"""Rules over all steps of a plan: what a path achieves, with the slack that it takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, bound_margin_db, connection_probability
from planopt.planning.history import History
from planopt.planning.proof.broad_prediction import Broad
from planopt.planning.proof.rules.expected import average_result, data_result
from planopt.planning.proof.rules.outage import outage_result
from planopt.planning.proof.rules.path_draws import joint_by_slack, path_draws_dbm
from planopt.planning.proof.rules.probable_data import probable_data_result
from planopt.planning.proof.rules.tolerance import is_missed
from planopt.planning.proof.serving import Serving
from planopt.planning.rule_result import RuleResult
from planopt.problems.problem import Problem

HALVINGS = 22
"""Bisections of the slack: 500 dB to a ten-thousandth."""

WORDS = {
    "average": "the share of steps connected on average",
    "joint": "the probability that all steps of the plan are connected",
    "outage": "the longest outage",
    "data": "the expected data delivered by the plan",
}
PROBABLE_DATA = "the probability that the plan keeps pace with constraints.data_mbit"


def whole_plan_result(
    problem: Problem,
    history: History,
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    power: Prediction,
    broad: Broad | None = None,
) -> RuleResult:
    """What a path achieves of a rule over all its steps, and by how many dB it misses it.

    The slack is the least lowering of the threshold with which the rule holds; where it does not
    within `slack_max_db`, or none is allowed, it is zero and the rule is missed.

    Parameters
    ----------
    problem, history
        What is asked, and what has happened.
    posterior
        What is believed of the channel: rules on steps together need more than `power`.
    positions_m
        ``(N + 1, 2)`` the path, the robot's own place first.
    power
        Prediction at the N places after each step.
    broad
        The stations, where there are several.
    """
    result_at = _result_by_slack(problem, history, posterior, positions_m, power, broad)
    hard = result_at(0.0)
    limit = problem.constraints.rule.slack_max_db or 0.0
    if limit == 0.0 or not is_missed(hard) or is_missed(result_at(limit)):
        return hard
    low, high = 0.0, limit
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_missed(result_at(middle)) else (low, middle)
    return replace(hard, slack_db=high)


def rule_reasons(problem: Problem, result: RuleResult) -> list[str]:
    """Why a path does not keep its rule; nothing where it does, within its slack."""
    if not is_missed(result) or result.slack_db > 0.0:
        return []
    words, key = (
        WORDS[result.connectivity],
        {
            "average": "constraints.p_min",
            "joint": "constraints.p_min",
            "outage": f"constraints.outage_max_{result.unit}",
            "data": "keeping pace with constraints.data_mbit",
        }[result.connectivity],
    )
    if result.connectivity == "data" and result.unit == "probability":
        words, key = PROBABLE_DATA, "constraints.p_min"
    unit = "" if result.unit == "probability" else f" {result.unit}"
    limit = problem.constraints.rule.slack_max_db
    return [
        f"{words} is {result.achieved:.4g}{unit} "
        f"({result.method}), {key} asks for {result.asked:.4g}{unit}"
        + (f", also with constraints.slack_max_db {limit:g}" if limit else "")
    ]


def _result_by_slack(
    problem: Problem,
    history: History,
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    power: Prediction,
    broad: Broad | None,
) -> Callable[[float], RuleResult]:
    """The rule's value as a function of how much lower the threshold is taken."""
    threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min
    mean, deviation = power.mean_db, power.deviation_db

    def probability(slack_db: float) -> NDArray[np.float64]:
        if isinstance(broad, Serving) and slack_db > 0.0:
            return broad.probability(positions_m[1:], slack_db)
        return connection_probability(mean, deviation, threshold - slack_db)

    match problem.constraints.rule.connectivity:
        case "average":
            return lambda slack_db: average_result(problem, history, probability(slack_db))
        case "data" if p_min > 0.0:
            drawn = path_draws_dbm(posterior, positions_m[1:], broad)
            return lambda slack_db: probable_data_result(problem, history, drawn, slack_db)
        case "data":
            return lambda slack_db: data_result(problem, history, probability(slack_db))
        case "outage":
            margin_db = bound_margin_db(mean, deviation, threshold, p_min)
            return lambda slack_db: outage_result(
                problem, history, positions_m, margin_db + slack_db
            )
        case "joint":
            return joint_by_slack(problem, posterior, positions_m[1:], broad)
        case _:
            raise AssertionError("a rule on single steps")
