"""Connected to any of several stations as one score: how far in a standard normal's deviations.

A station connects with probability Phi(z_i). With independent stations

    P(any) = 1 - prod (1 - Phi(z_i)) = Phi(z)

defines the score z of them all, which says as much as P where that has long been 0 or 1 to all
digits. Logarithms of both tails are kept, so that z has twelve digits from -1e3 to 1e3.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtri_exp  # pyright: ignore[reportUnknownVariableType]

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


def any_score(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """The score z of any of m stations with scores ``(m, ...)``; ``(...)``, infinite ones included.

    It is at least the largest of the scores, and is that where all others are far below; NaN where
    one of them is.
    """
    return _score(_log_any(scores), _log_normal(-scores).sum(axis=0))


def any_score_derivatives(
    scores: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """z, its gradient ``(m, ...)`` and its Hessian ``(m, m, ...)`` by the scores ``(m, ...)``.

    With phi the normal density, Q = prod (1 - Phi(z_j)) and h_j = phi(z_j) / (1 - Phi(z_j)):

        w_i = dz/dz_i = phi(z_i) / phi(z) prod_{j != i} (1 - Phi(z_j))
        d^2z/dz_i dz_j = w_i (z w_j - h_j),    d^2z/dz_i^2 = w_i (z w_i - z_i)

    Finite scores only.
    """
    none_each = _log_normal(-scores)
    none = none_each.sum(axis=0)
    z = _score(_log_any(scores), none)
    weight = np.exp(0.5 * (z * z - scores * scores) + none - none_each)
    hazard = np.exp(-0.5 * scores * scores - LOG_ROOT_2PI - none_each)
    hessian = weight[:, None] * (z * weight[None] - hazard[None])
    own = np.arange(len(scores))
    hessian[own, own] = weight * (z * weight - scores)
    return z, weight, hessian


def _log_normal(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(log_ndtr(scores), dtype=np.float64)


def _log_any(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log P(any), by P(a or b) = P(a) + P(b) (1 - P(a)): nothing is subtracted."""
    found = _log_normal(scores[0])
    none = _log_normal(-scores[0])
    with np.errstate(invalid="ignore"):  # what is not known stays NaN
        for score in scores[1:]:
            found = np.logaddexp(found, _log_normal(score) + none)
            none = none + _log_normal(-score)
    return found


def _score(log_any: NDArray[np.float64], log_none: NDArray[np.float64]) -> NDArray[np.float64]:
    """From the smaller tail, which has all the digits."""
    low = np.asarray(ndtri_exp(np.minimum(log_any, log_none)), dtype=np.float64)
    return np.where(log_any < log_none, low, -low)
