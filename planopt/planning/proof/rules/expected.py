"""Rules on expectations: the average share of connected steps, and the expected data delivered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.history import History
from planopt.planning.proof.rules.asked import data_asked_mbit
from planopt.planning.rule_result import RuleResult
from planopt.problems.problem import Problem


def average_result(
    problem: Problem, history: History, probability: NDArray[np.float64]
) -> RuleResult:
    """Share of the steps of the run so far and the plan that are connected, in expectation.

    Parameters
    ----------
    problem, history
        What is asked, and what has happened.
    probability
        ``(N,)`` of connection after each planned step, by what is known today (equation 3.1).
    """
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
