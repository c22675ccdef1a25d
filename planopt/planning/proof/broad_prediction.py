"""Predictions with xi, beta and omega uncertain besides path loss, where a problem asks for it.

The law is then a mixture over covariances (:mod:`planopt.channel.parameter_uncertainty`). What a
bound rests on is its quantile, which is found exactly. So that all else may go on with a mean and a
deviation, they are those of the normal law with the mixture's deviation and that very quantile.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameter_uncertainty import MarginalPosterior, marginalise, mixture
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, bound_quantile, connection_probability
from planopt.planning.proof.serving import Serving
from planopt.problems.problem import Problem

MOST_ROUNDS = 60
"""Steps towards a quantile at most: so many bisections lead from hundreds of dB to rounding."""
NEWTON_STEP_DB = 1e-8
"""After a step of Newton's method as short as this the next would be within rounding."""


@dataclass(frozen=True, eq=False)
class BroadPrediction:
    """Predicts for a bound that is to hold with probability `p_min` under all parameters.

    Attributes
    ----------
    marginal
        The channel given measurements, over several covariances.
    p_min
        The bound's probability.
    """

    marginal: MarginalPosterior
    p_min: float

    def __call__(self, positions_m: NDArray[np.float64]) -> Prediction:
        """Mean and deviation at `positions_m` (n, 2) whose bound margin is the mixture's."""
        weights = self.marginal.weights
        parts = [component.predict(positions_m) for component in self.marginal.components]
        deviation = mixture(weights, parts).deviation_db
        kept_dbm = mixture_quantile_dbm(weights, parts, self.p_min)
        return Prediction(kept_dbm + bound_quantile(self.p_min) * deviation, deviation)


def mixture_quantile_dbm(
    weights: NDArray[np.float64], parts: list[Prediction], p_min: float
) -> NDArray[np.float64]:
    """The power that a mixture of normal laws exceeds with probability `p_min`; ``(n,)``.

    Between the least and the greatest of the parts' own, by Newton's method, and by bisection where
    that leaves what is known to hold the quantile.
    """
    means = np.stack([part.mean_db for part in parts])
    deviations = np.stack([part.deviation_db for part in parts])
    own = means - bound_quantile(p_min) * deviations
    low: NDArray[np.float64] = own.min(axis=0)
    high: NDArray[np.float64] = own.max(axis=0)
    found: NDArray[np.float64] = 0.5 * (low + high)
    for _ in range(MOST_ROUNDS):
        # Of (mean - power) above zero.
        excess = weights @ connection_probability(means - found, deviations, 0.0) - p_min
        low, high = np.where(excess >= 0.0, found, low), np.where(excess < 0.0, found, high)
        density = weights @ _normal_density(found - means, deviations)
        step = np.divide(excess, density, out=np.full(len(found), np.inf), where=density > 0.0)
        middle = 0.5 * (low + high)
        better = np.where((low <= found + step) & (found + step <= high), found + step, middle)
        moved = np.abs(better - found)
        found = better
        if (moved <= NEWTON_STEP_DB).all():
            break
    return found


def _normal_density(
    away_db: NDArray[np.float64], deviation_db: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Density of normal laws; zero where the deviation is."""
    spread = deviation_db > 0.0
    score = np.divide(away_db, deviation_db, out=np.zeros_like(away_db), where=spread)
    bell = np.exp(-0.5 * score**2) / math.sqrt(2.0 * math.pi)
    return np.divide(bell, deviation_db, out=np.zeros_like(away_db), where=spread)


Broad = BroadPrediction | Serving
"""Predictions that are not of one posterior's normal law."""


def broad_prediction(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> Broad | None:
    """What the problem's bound rests on; None where the only posterior itself serves.

    Parameters
    ----------
    problem
        What is asked.
    posteriors
        Of each of its stations.
    """
    if len(posteriors) > 1 or posteriors[0].outcomes is not None:
        thresholds = tuple(radio.threshold_dbm for radio in problem.stations)
        return Serving(tuple(posteriors), thresholds, problem.constraints.p_min)
    (posterior,) = posteriors
    if problem.constraints.rule.parameter_uncertainty == "path_loss":
        return None
    marginal = marginalise(posterior.parameters, posterior.measurements)
    return BroadPrediction(marginal, problem.constraints.p_min)
