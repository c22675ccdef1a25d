"""Predicted power, its kriging terms, and connection probabilities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv, ndtr, ndtri  # pyright: ignore[reportUnknownVariableType]

from planopt.arrays import Floats, Indices
from planopt.short_repr import short_repr


@dataclass(frozen=True)
class Prediction:
    """Predicted received power.

    Attributes
    ----------
    mean_db
        ``(n,)`` predicted mean in dBm.
    deviation_db
        ``(n,)`` standard deviation of the power that would be measured, from shadowing, multipath
        and the uncertainty of theta.
    """

    mean_db: Floats
    deviation_db: Floats

    __repr__ = short_repr

    def at(self, rows: Indices) -> Prediction:
        """Return the prediction at a subset of the positions."""
        return Prediction(self.mean_db[rows], self.deviation_db[rows])


@dataclass(frozen=True)
class KrigingTerms:
    """Terms of a prediction at n positions that do not depend on path loss (equation 1.6)."""

    data_db: Floats  # (n,) a = phi' U^-1 y
    trend: Floats  # (n, 2) varphi = gamma - Gamma' U^-1 phi
    variance_db2: Floats  # (n,) s = xi^2 + omega^2 - phi' U^-1 phi


def combine(terms: KrigingTerms, theta: Floats, theta_covariance: Floats) -> Prediction:
    """Return mean and variance for the path loss theta with covariance M (equation 1.8)."""
    first, second = terms.trend[..., 0], terms.trend[..., 1]
    mean = terms.data_db + first * theta[0] + second * theta[1]
    variance = terms.variance_db2 + (
        theta_covariance[0, 0] * first**2
        + 2.0 * theta_covariance[0, 1] * first * second
        + theta_covariance[1, 1] * second**2
    )
    return Prediction(mean, np.sqrt(variance))


def bound_quantile(p_min: float) -> float:
    """Return z_p, the `p_min` quantile of the standard normal (equation 3.2)."""
    return float(np.asarray(ndtri(p_min), dtype=np.float64))


def bound_margin_db(
    mean_db: Floats, deviation_db: Floats, threshold_dbm: float, p_min: float
) -> Floats:
    """Return mean - z_p deviation - threshold in dB, infinite if `p_min` is 0 (equation 3.2)."""
    kept_db = bound_quantile(p_min) * (deviation_db if p_min > 0.0 else 1.0)
    return mean_db - kept_db - threshold_dbm


def connection_probability(mean_db: Floats, deviation_db: Floats, threshold_dbm: float) -> Floats:
    """Return P(power >= threshold) = Phi((mean - threshold) / deviation) (equation 3.1)."""
    # The result is NaN if the prediction is NaN, and 0 or 1 if the standard deviation is 0.
    above = mean_db - threshold_dbm
    certain = np.where(above >= 0.0, np.inf, -np.inf)
    return score_probability(np.divide(above, deviation_db, out=certain, where=deviation_db != 0.0))


def score_probability(score: Floats) -> Floats:
    """Return the normal probability of scores (mean - threshold) / deviation."""
    return np.asarray(ndtr(score), dtype=np.float64)


CONFIDENCE = 0.95
"""Level of all confidence intervals."""


def binomial_interval(successes: float, trials: float) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a probability; counts may be fractional."""
    failures, tail = trials - successes, 0.5 - 0.5 * CONFIDENCE
    low = 0.0 if successes <= 0.0 else float(betaincinv(successes, failures + 1.0, tail))
    high = 1.0 if failures <= 0.0 else float(betaincinv(successes + 1.0, failures, 1.0 - tail))
    return low, high
