"""The calibrated law of a connection: Platt scaling of how far the mean is above the threshold.

With u = (mean - threshold) / deviation, the score of a prediction, the normal law says

    P(power >= threshold) = Phi(u).

The calibrated law says (Platt, "Probabilistic outputs for support vector machines", 1999)

    logit P(power >= threshold) = intercept + slope u,

a logistic law of the power about a shifted mean, whose tails are heavier than the normal one's. Its
quantiles are of the same form as the normal ones: the bound P >= p_min is

    mean - q_p deviation - threshold >= 0,    q_p = (logit p_min - intercept) / slope.

:data:`NEUTRAL_SLOPE` with intercept 0 is the logistic law nearest to the normal one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_expit, ndtri_exp  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.connectivity import bound_quantile
from planopt.channel.intervals.censoring import MIN_NOISE_VARIANCE_DB2
from planopt.channel.prediction import Prediction

NEUTRAL_SLOPE = 1.702
"""The logistic law of this slope is within 0.0095 of the normal law everywhere (Haley 1952)."""

LEAST_DEVIATION_DB = math.sqrt(MIN_NOISE_VARIANCE_DB2)
"""Powers that are known would be steps; so little spread decides ties evenly."""

SECANT_FROM = 1e-6
"""Nearer to the quantile the slope of the normal score stands for its secant."""

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


@dataclass(frozen=True)
class ConnectionLaw:
    """How probable a connection is, by the score of its prediction.

    Attributes
    ----------
    intercept
        Logit of the probability where the predicted mean is at the threshold.
    slope
        By how much the logit grows with a deviation; above 0.
    """

    intercept: float = 0.0
    slope: float = NEUTRAL_SLOPE

    def quantile(self, p_min: float) -> float:
        """q_p: the score from which on the probability is at least `p_min`, between 0 and 1."""
        return (math.log(p_min) - math.log1p(-p_min) - self.intercept) / self.slope

    def normal_score(self, score: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return h with Phi(h) the probability at `score`; shapes alike, NaN where that is."""
        logit = self.intercept + self.slope * score
        tail = np.asarray(ndtri_exp(log_expit(-np.abs(logit))), dtype=np.float64)
        return np.where(logit < 0.0, tail, -tail)

    def normal_score_derivatives(
        self, score: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return h, dh/du and d2h/du2 at `score`.

        With G the probability: h' = slope G (1 - G) / phi(h), h'' = h' (slope (1 - 2 G) + h h').
        """
        logit = self.intercept + self.slope * score
        h = self.normal_score(score)
        log_up, log_down = log_expit(logit), log_expit(-logit)
        first = self.slope * np.exp(log_up + log_down + 0.5 * h * h + LOG_ROOT_2PI)
        second = first * (-self.slope * np.tanh(0.5 * logit) + h * first)
        return h, first, second

    def prediction(self, raw: Prediction, threshold_dbm: float, p_min: float = 0.0) -> Prediction:
        """Return the normal law that agrees with the calibrated one where it counts.

        Its probability of a power of at least the threshold is the calibrated one, and so is the
        power that it exceeds with probability `p_min`, and with it the margin in dB. Where `p_min`
        asks for nothing (0), it has the slope of the calibrated law at the threshold.

        Parameters
        ----------
        raw
            Mean and deviation at n places; NaN stays NaN.
        threshold_dbm
            From which power on a place is connected.
        p_min
            The bound, below 1.
        """
        deviation = np.maximum(raw.deviation_db, LEAST_DEVIATION_DB)
        score = (raw.mean_db - threshold_dbm) / deviation
        normal, slope, _ = self.normal_score_derivatives(score)
        spread = 1.0 / slope
        if p_min > 0.0:
            away = score - self.quantile(p_min)
            far = np.abs(away) > SECANT_FROM
            np.divide(away, normal - bound_quantile(p_min), out=spread, where=far)
        spread *= deviation
        return Prediction(threshold_dbm + spread * normal, spread)
