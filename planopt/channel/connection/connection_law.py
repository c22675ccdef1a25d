"""The calibrated law of a connection: Platt scaling of how far the mean is above the threshold.

With u = (mean - threshold) / deviation, the score of a prediction, the normal law says

    P(power >= threshold) = Phi(u).

The calibrated law says (Platt, "Probabilistic outputs for support vector machines", 1999)

    logit P(power >= threshold) = intercept + slope u,

a logistic law of the power about a shifted mean, whose tails are heavier than the normal one's. Its
quantiles are of the same form as the normal ones: the bound P >= p_min is

    mean - q_p deviation - threshold >= 0,    q_p = (logit p_min - intercept) / slope.

:data:`NEUTRAL_SLOPE` with intercept 0 is the logistic law nearest to the normal one.

A distribution known by draws from it, with the intervals that their number leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import (  # pyright: ignore[reportUnknownVariableType]
    betaincinv,  # pyright: ignore[reportUnknownVariableType]
    log_expit,
    ndtri_exp,
)

from planopt.channel.intervals.censoring import MIN_NOISE_VARIANCE_DB2
from planopt.channel.prediction import Prediction, bound_quantile
from planopt.errors import InputError
from planopt.short_repr import short_repr

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


CONFIDENCE = 0.95
"""Of every interval here."""


@dataclass(frozen=True)
class Interval:
    """An estimate and its 95 % confidence interval.

    Attributes
    ----------
    value
        The estimate.
    low, high
        Ends of the interval.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class SampledDistribution:
    """Independent draws of one number.

    Attributes
    ----------
    draws
        ``(count,)`` in the order drawn, count at least 2.
    """

    draws: NDArray[np.float64]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.draws.ndim != 1 or len(self.draws) < 2:
            raise InputError(
                f"draws of shape {self.draws.shape} are no distribution",
                key="count",
                remedy="draw at least 2",
            )

    @property
    def count(self) -> int:
        """How many draws."""
        return len(self.draws)

    def mean(self) -> Interval:
        """The mean, its interval by the central limit theorem."""
        value = float(self.draws.mean())
        half = _score() * float(self.draws.std(ddof=1)) / math.sqrt(self.count)
        return Interval(value, value - half, value + half)

    def quantile(self, share: float) -> Interval:
        """The value that is not exceeded with probability `share`; the interval by ranks.

        Raises
        ------
        InputError
            `share` is not from 0 to 1.
        """
        if not 0.0 <= share <= 1.0:
            raise InputError(f"{share!r} is no probability", key="share", remedy="give 0 to 1")
        half = _score() * math.sqrt(share * (1.0 - share) / self.count)
        shares = np.clip([share, share - half, share + half], 0.0, 1.0)
        value, low, high = np.quantile(self.draws, shares, method="inverted_cdf").tolist()
        return Interval(value, low, high)

    def exceedance(self, limit: float) -> Interval:
        """P(more than `limit`), with Clopper and Pearson's interval, which holds at any count."""
        above = float((self.draws > limit).sum())
        below = self.count - above
        tail = 0.5 * (1.0 - CONFIDENCE)
        low = 0.0 if above == 0.0 else _beta_quantile(above, below + 1.0, tail)
        high = 1.0 if below == 0.0 else _beta_quantile(above + 1.0, below, 1.0 - tail)
        return Interval(above / self.count, low, high)


def _score() -> float:
    return bound_quantile(0.5 + 0.5 * CONFIDENCE)


def _beta_quantile(first: float, second: float, share: float) -> float:
    return float(np.asarray(betaincinv(first, second, share), dtype=np.float64))
