"""The normal distribution of two variables, for arrays of pairs, by Owen's T function."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, owens_t  # pyright: ignore[reportUnknownVariableType]

FAR = 40.0
"""Scores are not taken further out: the normal tail there is below the smallest float."""

VANISHING = 1e-200
"""Smaller scores count as zero: their products would, and quotients of those are no numbers."""


def bivariate_normal_cdf(
    first: NDArray[np.float64], second: NDArray[np.float64], correlation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """P(X <= first, Y <= second) for standard normal X, Y of the given correlation.

    Exact to rounding, about 1e-15 (D. B. Owen, Tables for computing bivariate normal
    probabilities, 1956). Arguments broadcast; infinite scores and correlations of 1 and -1 are
    taken as what they are.
    """
    h, k, rho = np.broadcast_arrays(_score(first), _score(second), np.clip(correlation, -1.0, 1.0))
    narrow = np.sqrt((1.0 - rho) * (1.0 + rho))
    crossing = (h < 0.0) != (k < 0.0)
    found = (
        0.5 * (_array(ndtr(h)) + _array(ndtr(k)))
        - _owen(h, k - rho * h, narrow)
        - _owen(k, h - rho * k, narrow)
        - 0.5 * crossing
    )
    # Two zero scores leave Owen's slopes 0 / 0.
    found = np.where((h == 0.0) & (k == 0.0), 0.25 + np.arcsin(rho) / (2.0 * np.pi), found)
    lower, upper = _array(ndtr(h)), _array(ndtr(k))
    found = np.where(rho >= 1.0, np.minimum(lower, upper), found)
    found = np.where(rho <= -1.0, lower + upper - 1.0, found)
    return np.clip(found, np.maximum(0.0, lower + upper - 1.0), np.minimum(lower, upper))


def _score(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scores that quotients can be made of."""
    scores = np.clip(_array(values), -FAR, FAR)
    return np.where(np.abs(scores) < VANISHING, 0.0, scores)


def _owen(
    score: NDArray[np.float64], across: NDArray[np.float64], narrow: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Owen's T(score, across / (score narrow)); a zero score makes the slope infinite."""
    # Zero is added so that a score of -0 is one of 0. What is 0 / 0 here the caller replaces.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        slope = across / (score * narrow + 0.0)
    return _array(owens_t(score, slope))


def _array(values: object) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
