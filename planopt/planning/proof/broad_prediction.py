"""Predictions with xi, beta and omega uncertain besides path loss, where a problem asks for it.

The law is then a mixture over covariances (:mod:`planopt.channel.parameter_uncertainty`). What a
bound rests on is its quantile, which is found exactly. So that all else may go on with a mean and a
deviation, they are those of the normal law with the mixture's deviation and that very quantile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameter_uncertainty import MarginalPosterior, marginalise, mixture
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, bound_quantile, connection_probability
from planopt.planning.proof.serving import Serving
from planopt.problems.problem import Problem

HALVINGS = 60
"""Bisections of a quantile: from hundreds of dB to rounding."""


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

    Between the least and the greatest of the parts' own; the lower end of the bisection.
    """
    own = np.stack([p.mean_db - bound_quantile(p_min) * p.deviation_db for p in parts])
    low: NDArray[np.float64] = own.min(axis=0)
    high: NDArray[np.float64] = own.max(axis=0)
    for _ in range(HALVINGS):
        middle: NDArray[np.float64] = 0.5 * (low + high)
        chance = np.zeros(len(middle))
        for weight, part in zip(weights.tolist(), parts, strict=True):
            # Of (mean - power) above zero.
            chance += weight * connection_probability(part.mean_db - middle, part.deviation_db, 0.0)
        kept = chance >= p_min
        low = np.where(kept, middle, low)
        high = np.where(kept, high, middle)
    return low


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
