"""What depends on all steps of a path together, by the law of one station or of several.

One station's powers along a path are jointly normal. The serving power of several is not: their
channels are drawn, each by itself, as many each time and from the same seeds. A calibrated law of
connection changes how probable each place is, and leaves how places depend on each other as the
posterior has it (a Gaussian copula).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.serving_power import serving_power_dbm
from planopt.channel.joint import JointPrediction
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.planning.proof.broad_prediction import Broad
from planopt.planning.proof.rules.joint import joint_result, path_prediction
from planopt.planning.proof.rules.probable_data import DRAWN, drawn_powers_dbm, share_at_least
from planopt.planning.proof.serving import Serving, connection_law
from planopt.planning.rule_result import RuleResult
from planopt.problems.problem import Problem


def path_draws_dbm(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], broad: Broad | None
) -> NDArray[np.float64]:
    """Powers along a path (N, 2) in drawn channels, of several stations the serving ones."""
    if not isinstance(broad, Serving):
        return drawn_powers_dbm(path_prediction(posterior, path_m))
    each = [
        drawn_powers_dbm(calibrated_path(station, path_m, threshold), number)
        for number, (station, threshold) in enumerate(
            zip(broad.posteriors, broad.thresholds_dbm, strict=True)
        )
    ]
    return serving_power_dbm(np.stack(each), broad.thresholds_dbm)


def calibrated_path(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], threshold_dbm: float
) -> JointPrediction:
    """Return powers at the places (N, 2) of a path together, each by the station's own law.

    Where the law is calibrated, means and deviations are those of the normal laws that give the
    calibrated probabilities of at least `threshold_dbm`; correlations stay.
    """
    raw = path_prediction(posterior, path_m)
    law = connection_law(posterior)
    if law is None:
        return raw
    found = law.prediction(Prediction(raw.mean_db, raw.deviation_db), threshold_dbm)
    ratio = found.deviation_db / raw.deviation_db
    return JointPrediction(found.mean_db, raw.covariance_db2 * np.outer(ratio, ratio))


def joint_by_slack(
    problem: Problem,
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],
    broad: Broad | None,
) -> Callable[[float], RuleResult]:
    """A lower bound of the probability that all steps are connected, by how much slack there is.

    Of one station by :func:`planopt.planning.proof.rules.joint.joint_result`; of several the lower
    end of the interval over the drawn channels.

    Parameters
    ----------
    problem, posterior, broad
        What is asked, and what is believed of the first station and of all, if there are several.
    path_m
        ``(N, 2)`` places after each step.
    """
    if not isinstance(broad, Serving) or len(broad.posteriors) == 1:
        prediction = calibrated_path(posterior, path_m, problem.stations[0].threshold_dbm)
        return lambda slack_db: joint_result(problem, prediction, slack_db)
    least_dbm = path_draws_dbm(posterior, path_m, broad).min(axis=1)

    def drawn(slack_db: float) -> RuleResult:
        kept = int((least_dbm >= problem.stations[0].threshold_dbm - slack_db).sum())
        achieved = share_at_least(kept, len(least_dbm))
        return RuleResult("joint", achieved, problem.constraints.p_min, "probability", DRAWN)

    return drawn
