"""Predicted power, and the parts that it is combined from once theta is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.short_repr import short_repr


@dataclass(frozen=True)
class Prediction:
    """Predicted received power.

    Attributes
    ----------
    mean_db
        ``(n,)`` dBm.
    deviation_db
        ``(n,)`` of the power that would be measured: shadowing, multipath and the uncertainty of
        theta.
    """

    mean_db: NDArray[np.float64]
    deviation_db: NDArray[np.float64]

    __repr__ = short_repr


@dataclass(frozen=True)
class KrigingTerms:
    """Parts of a prediction that do not depend on theta (equation 1.6), for n places.

    Attributes
    ----------
    data_db
        ``(n,)`` a = phi' U^-1 y.
    trend
        ``(n, 2)`` varphi = gamma - Gamma' U^-1 phi.
    variance_db2
        ``(n,)`` s = xi^2 + omega^2 - phi' U^-1 phi.
    """

    data_db: NDArray[np.float64]
    trend: NDArray[np.float64]
    variance_db2: NDArray[np.float64]


def combine(
    terms: KrigingTerms, theta: NDArray[np.float64], theta_covariance: NDArray[np.float64]
) -> Prediction:
    """Combine to mean a + varphi' theta and variance s + varphi' M varphi (equation 1.8)."""
    first, second = terms.trend[..., 0], terms.trend[..., 1]
    mean = terms.data_db + first * theta[0] + second * theta[1]
    variance = terms.variance_db2 + (
        theta_covariance[0, 0] * first**2
        + 2.0 * theta_covariance[0, 1] * first * second
        + theta_covariance[1, 1] * second**2
    )
    return Prediction(mean, np.sqrt(variance))
