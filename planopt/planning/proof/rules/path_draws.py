"""Powers along a path in drawn channels, for rules on correlated steps.

One station's powers along a path are jointly normal. The serving power of several is not: their
channels are drawn, each by itself, as many each time and from the same seeds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.joint import JointPrediction, joint_prediction
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.errors import InputError
from planopt.planning.certificate import RuleResult
from planopt.planning.proof.rules.rule import BySlack, PathCase, Rule
from planopt.problems.problem import Problem

DRAWS, SEED = 10_000, 0
"""Number of drawn channels, and their seed."""

DOUBT = 0.01
"""The lower end of the interval of this one-sided doubt counts (Clopper and Pearson, 1934)."""

DRAWN = f"{DRAWS} drawn channels, lower end of the {1.0 - DOUBT:.0%} interval"
"""Name of the method."""

MOST_PROBABLE = 0.9995
"""Greatest p_min that the drawn channels can show."""


def require_shown(problem: Problem, words: str, remedy: str) -> None:
    """Raise an InputError where p_min is more than drawn channels can show."""
    p_min = problem.constraints.p_min
    if p_min > MOST_PROBABLE:
        raise InputError(
            f"is {p_min:g}, and more than {MOST_PROBABLE:g} cannot be shown {words}",
            file=problem.file,
            key="constraints.p_min",
            remedy=f"ask for less, or {remedy}",
        )


def share_at_least(count: int, of: int) -> float:
    """Lower end of the one-sided interval of a probability seen `count` times `of` so many."""
    if count == 0:
        return 0.0
    return float(np.asarray(betaincinv(count, of - count + 1, DOUBT), dtype=np.float64))


def path_prediction(posterior: ChannelPosterior, path_m: NDArray[np.float64]) -> JointPrediction:
    """Predict the powers at the places (N, 2) of a path jointly (equation 1.12).

    Where there are too many measurements for a factor, by the nearest to the path: a true posterior
    of less data.
    """
    return joint_prediction(factored_near(posterior, path_m), path_m)


def drawn_by_slack(
    rule: Rule,
    case: PathCase,
    is_kept: Callable[[NDArray[np.bool_]], NDArray[np.bool_]],  # (n, N) connected to (n,)
) -> BySlack:
    """Return a lower bound of the probability that the rule is kept, by drawn channels."""
    drawn_dbm = case.context.law.sample(case.positions_m[1:], DRAWS, SEED)
    threshold, p_min = case.problem.stations[0].threshold_dbm, case.problem.constraints.p_min

    def result(slack_db: float) -> RuleResult:
        kept = int(is_kept(drawn_dbm >= threshold - slack_db).sum())
        achieved = share_at_least(kept, len(drawn_dbm))
        return RuleResult(rule.kind, achieved, p_min, "probability", DRAWN)

    return result
