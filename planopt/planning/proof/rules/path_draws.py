"""Quantities of all steps of a path together, by the law of one station or of several.

One station's powers along a path are jointly normal. The serving power of several is not: their
channels are drawn independently, with the same seeds each time. The rule `joint` bounds the
probability that every step of the plan is connected.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.joint_connectivity import JointConnectivity, joint_connectivity
from planopt.channel.connection.serving_power import serving_power_dbm
from planopt.channel.joint import JointPrediction, joint_prediction
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.planning.certificate import RuleResult
from planopt.planning.proof.predictions import Broad, Serving
from planopt.planning.proof.rules.probable_data import DRAWN, drawn_powers_dbm, share_at_least
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
    return joint_prediction(factored_near(posterior, path_m), path_m)


def joint_result(
    problem: Problem, prediction: JointPrediction, slack_db: float = 0.0
) -> RuleResult:
    """Return a lower bound of the probability that all steps are connected (equation 5.2).

    The integral less its error, or the greatest of Boole's, Hunter's and Slepian's bounds.
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


def path_draws_dbm(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], broad: Broad | None
) -> NDArray[np.float64]:
    """Powers along a path (N, 2) in drawn channels, of several stations the serving ones."""
    if not isinstance(broad, Serving):
        return drawn_powers_dbm(path_prediction(posterior, path_m))
    each = [
        drawn_powers_dbm(path_prediction(station, path_m), number)
        for number, station in enumerate(broad.posteriors)
    ]
    return serving_power_dbm(np.stack(each), broad.thresholds_dbm)


def joint_by_slack(
    problem: Problem,
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],  # (N, 2) places after each step
    broad: Broad | None,
) -> Callable[[float], RuleResult]:
    """A lower bound of the probability that all steps are connected, by how much slack there is.

    Of one station by :func:`joint_result`; of several the lower
    end of the interval over the drawn channels.
    """
    if not isinstance(broad, Serving):
        prediction = path_prediction(posterior, path_m)
        return lambda slack_db: joint_result(problem, prediction, slack_db)
    least_dbm = path_draws_dbm(posterior, path_m, broad).min(axis=1)

    def drawn(slack_db: float) -> RuleResult:
        kept = int((least_dbm >= problem.stations[0].threshold_dbm - slack_db).sum())
        achieved = share_at_least(kept, len(least_dbm))
        return RuleResult("joint", achieved, problem.constraints.p_min, "probability", DRAWN)

    return drawn
