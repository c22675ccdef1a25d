"""The share of a rule of connectivity that one plan must keep, and when it counts as missed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.certificate import RuleResult
from planopt.planning.history import History, data_of_steps_mbit
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB, RULE_TOLERANCE
from planopt.problems.problem import Problem


def margin_missed(margin_db: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return where margins are below zero by more than rounding."""
    return margin_db < -MARGIN_TOLERANCE_DB


def is_missed(result: RuleResult) -> bool:
    """Return whether a rule is missed by more than rounding."""
    return result.missing > RULE_TOLERANCE * max(1.0, abs(result.asked))


def data_asked_mbit(
    problem: Problem, history: History, count: int
) -> tuple[NDArray[np.float64], float]:
    """Return data of each step if connected ``(count,)``, and what must be delivered in all.

    What is missing is spread evenly over the time until the deadline: a plan that ends before it
    must deliver its share, one that reaches it everything.
    """
    rule = problem.constraints.rule
    each = data_of_steps_mbit(problem, history.steps, count)
    if rule.data_mbit is None or rule.deadline_s is None or rule.rate_mbit_s is None:
        raise AssertionError("no data are asked for")
    left_s = rule.deadline_s - history.steps * problem.planner.step_s
    missing = max(rule.data_mbit - history.delivered_mbit, 0.0)
    if left_s <= 0.0 or missing == 0.0:
        return each, 0.0
    share = float(each.sum()) / (rule.rate_mbit_s * left_s)
    return each, missing * share


def connected_steps_asked(problem: Problem, history: History, count: int) -> float:
    """Return how many steps must be connected, for the average over run and plan."""
    return problem.constraints.p_min * (history.steps + count) - history.connected_steps


def is_priced(problem: Problem) -> bool:
    """Return whether single steps may miss the bound at a price, on the way to a goal.

    A stated time is asked for itself: the price is of metres, and a robot may wait in contact.
    """
    return problem.task == "reach" and problem.constraints.rule.is_plain
