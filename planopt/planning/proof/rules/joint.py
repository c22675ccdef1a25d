"""The rule on all steps together: the probability that every step of the plan is connected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.joint_connectivity import JointConnectivity, joint_connectivity
from planopt.channel.joint import JointPrediction, joint_prediction
from planopt.channel.nearest.nearby import NEIGHBOURS_BEYOND
from planopt.channel.posterior import ChannelPosterior, condition
from planopt.planning.rule_result import RuleResult
from planopt.problems.problem import Problem

SEED = 0
"""Of the integral's shifts: the same path is judged the same again."""

ACCURACY = 4e-3
"""Three standard errors that the integral is refined to. Its value counts less its error."""

INTEGRATED_STEPS = 60
"""Up to so many steps the probability is integrated; beyond, the greatest lower bound serves."""


def path_prediction(posterior: ChannelPosterior, path_m: NDArray[np.float64]) -> JointPrediction:
    """Predict the powers at the places (N, 2) of a path jointly (equation 1.12).

    Where there are too many measurements for a factor, by the nearest to the path: a true posterior
    of less data.
    """
    if posterior.has_factor:
        return joint_prediction(posterior, path_m)
    near, _ = posterior.index.nearest(path_m, max(NEIGHBOURS_BEYOND // len(path_m), 1))
    nearest = posterior.measurements.take(np.unique(near))
    return joint_prediction(
        condition(posterior.parameters, nearest, theta=posterior.theta_rule), path_m
    )


def joint_result(
    problem: Problem, prediction: JointPrediction, slack_db: float = 0.0
) -> RuleResult:
    """Return a lower bound of the probability that all steps are connected (equation 5.2).

    The integral less its error, or the greatest of Boole's, Hunter's and Slepian's bounds.

    Parameters
    ----------
    problem
        What is asked.
    prediction
        Of the places after each step, today's deviation.
    slack_db
        The threshold is taken so much lower.
    """
    threshold = problem.stations[0].threshold_dbm - slack_db
    p_min = problem.constraints.p_min
    found = joint_connectivity(prediction, threshold)
    # Where the least certain step alone misses the bound, no integral is needed.
    if len(prediction) <= INTEGRATED_STEPS and found.at_each.min() >= p_min:
        generator = np.random.default_rng(SEED)
        found = joint_connectivity(prediction, threshold, generator, ACCURACY)
    achieved, method = _best_bound(found)
    return RuleResult("joint", achieved, p_min, "probability", method)


def _best_bound(found: JointConnectivity) -> tuple[float, str]:
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
    return proven[best], best
