"""Choose the posterior: certificates rest on all measurements, searches on a nearby subset.

A bound may also rest on more than one normal power: on several stations, or on a mixture over
covariances (:mod:`planopt.channel.parameter_uncertainty`). The bound rests on the mixture's
quantile, which is found exactly. Everything else goes on with the mean and deviation of the normal
law that has the mixture's deviation and that quantile.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.serving_power import any_probability, serving_prediction
from planopt.channel.kriging import predict
from planopt.channel.nearest.local_channel import NEIGHBOURS_BEYOND, predict_nearby
from planopt.channel.parameter_uncertainty import MarginalPosterior, marginalise, mixture
from planopt.channel.posterior import EXACT_LIMIT, ChannelPosterior
from planopt.channel.prediction import Prediction, bound_quantile, connection_probability
from planopt.problems.problem import Problem


@dataclass(frozen=True, eq=False)
class Serving:
    """The beliefs of stations, each of which may connect."""

    posteriors: tuple[ChannelPosterior, ...]  # Of each station's channel
    # From which power on each connects; predictions are judged by the first
    thresholds_dbm: tuple[float, ...]
    p_min: float  # The bound's probability

    def law(self, predictions: Sequence[Prediction]) -> Prediction:
        """Return the prediction of the serving power, from those of each station's power."""
        return serving_prediction(predictions, self.thresholds_dbm, self.p_min)

    def probability(self, positions_m: NDArray[np.float64], slack_db: float) -> NDArray[np.float64]:
        """P(any) at places (n, 2) with all thresholds lowered by a slack; ``(n,)``."""
        each = [posterior.predict(positions_m) for posterior in self.posteriors]
        return any_probability(each, self.thresholds_dbm, slack_db)


SEARCH_EXACT_LIMIT = 1000
"""Up to this many measurements searches use the full posterior too."""
SEARCH_NEIGHBOURS = 128
"""Nearest measurements a place beyond that: some thousandths of a dB off, and no slower however
many there are."""

SEARCH_ERROR_DB = 2e-3
"""Beyond that, margins smaller than this are not relied on before they are certified."""


def is_search_exact(posterior: ChannelPosterior) -> bool:
    """Return whether searches look at what certificates rest on."""
    return len(posterior.measurements) <= SEARCH_EXACT_LIMIT


def certified_prediction(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    broad: Broad | None = None,
) -> tuple[Prediction, str]:
    """Prediction that certificates rest on, and its name in them; by `broad` where there is one."""
    if isinstance(broad, Serving):
        found = [certified_prediction(each, positions_m) for each in broad.posteriors]
        kind = next((kind for _, kind in found if kind != "exact"), "exact")
        return broad.law([prediction for prediction, _ in found]), kind
    if broad is not None:
        exact = len(posterior.measurements) <= EXACT_LIMIT
        return broad(positions_m), "exact" if exact else f"neighbours:{NEIGHBOURS_BEYOND}"
    if len(posterior.measurements) <= EXACT_LIMIT:
        return predict(posterior, positions_m), "exact"
    nearby = predict_nearby(posterior, positions_m, NEIGHBOURS_BEYOND)
    return nearby, f"neighbours:{NEIGHBOURS_BEYOND}"


def search_prediction(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    broad: Broad | None = None,
) -> Prediction:
    """Prediction that searches look at; what they find is certified afterwards."""
    if isinstance(broad, Serving):
        return broad.law([search_prediction(each, positions_m) for each in broad.posteriors])
    if broad is not None:
        return broad(positions_m)
    if is_search_exact(posterior):
        return predict(posterior, positions_m)
    return predict_nearby(posterior, positions_m, SEARCH_NEIGHBOURS)


MOST_ROUNDS = 60
"""Steps towards a quantile at most: so many bisections lead from hundreds of dB to rounding."""
NEWTON_STEP_DB = 1e-8
"""After a step of Newton's method as short as this the next would be within rounding."""


@dataclass(frozen=True, eq=False)
class BroadPrediction:
    """Predicts for a bound that is to hold with probability `p_min` under all parameters."""

    marginal: MarginalPosterior  # The channel given measurements, over several covariances
    p_min: float  # The bound's probability

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
    """Return the prediction that the bound rests on; None where the only posterior serves."""
    if len(posteriors) > 1:
        thresholds = tuple(radio.threshold_dbm for radio in problem.stations)
        return Serving(tuple(posteriors), thresholds, problem.constraints.p_min)
    (posterior,) = posteriors
    if problem.constraints.rule.parameter_uncertainty == "path_loss":
        return None
    marginal = marginalise(posterior.parameters, posterior.measurements)
    return BroadPrediction(marginal, problem.constraints.p_min)
