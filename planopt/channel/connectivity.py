"""From predicted power to the probability of being connected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri  # pyright: ignore[reportUnknownVariableType]


def bound_quantile(p_min: float) -> float:
    """Return z_p, the `p_min` quantile of the standard normal (equation 3.2)."""
    return float(np.asarray(ndtri(p_min), dtype=np.float64))


def bound_margin_db(
    mean_db: NDArray[np.float64],
    deviation_db: NDArray[np.float64],
    threshold_dbm: float,
    p_min: float,
) -> NDArray[np.float64]:
    """Return the margin in dB by which P(power >= threshold) >= `p_min` holds (equation 3.2).

    ``mean - z_p deviation - threshold`` with z_p the `p_min` quantile of the standard normal;
    negative where the bound is missed, NaN where the prediction is. Shapes as `mean_db`.
    """
    return mean_db - bound_quantile(p_min) * deviation_db - threshold_dbm


def connection_probability(
    mean_db: NDArray[np.float64], deviation_db: NDArray[np.float64], threshold_dbm: float
) -> NDArray[np.float64]:
    """Return P(power >= threshold) = Phi((mean - threshold) / deviation) (equation 3.1).

    NaN where the prediction is; 0 or 1 where the deviation is 0. Shapes as `mean_db`.
    """
    above = mean_db - threshold_dbm
    certain = np.where(above >= 0.0, np.inf, -np.inf)
    return score_probability(np.divide(above, deviation_db, out=certain, where=deviation_db != 0.0))


def score_probability(score: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phi(score): how probable power above the threshold is, (mean - threshold) / deviation."""
    return np.asarray(ndtr(score), dtype=np.float64)
