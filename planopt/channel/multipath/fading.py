"""Rician small-scale fading in dB with unit mean power, its mean in dB subtracted.

The amplitude is a constant plus a complex Gaussian; K is the ratio of their powers. Given a
Poisson variable J of mean K the power times K + 1 is Gamma(1 + J), which gives the moments of
its logarithm as a series (equation 1.5).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, psi, zeta  # pyright: ignore[reportUnknownVariableType]

DB_PER_NEPER = 10.0 / math.log(10.0)

SERIES_DEVIATIONS = 12.0
"""The series runs over this many standard deviations of J on both sides, and 40 terms more."""


def rician_field_db(
    shape: tuple[int, ...], k_factor: float, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Independent fading values in dB, of mean zero and deviation :func:`rician_std_db`.

    Parameters
    ----------
    shape
        Shape of the result.
    k_factor
        K >= 0, linear; 0 is Rayleigh fading.
    generator
        Source of randomness.
    """
    constant = math.sqrt(k_factor / (k_factor + 1.0))
    scatter = math.sqrt(0.5 / (k_factor + 1.0))
    real = constant + scatter * generator.standard_normal(shape)
    imaginary = scatter * generator.standard_normal(shape)
    power = real * real + imaginary * imaginary
    return 10.0 * np.log10(power) - rician_mean_db(k_factor)


def rician_mean_db(k_factor: float) -> float:
    """Mean in dB of fading whose mean power is one; negative."""
    return _log_moments(k_factor)[0]


def rician_std_db(k_factor: float) -> float:
    """Deviation omega in dB of fading of factor K = `k_factor`."""
    return _log_moments(k_factor)[1]


def _log_moments(k_factor: float) -> tuple[float, float]:
    """Mean and deviation in dB by the Poisson mixture of gamma variables."""
    spread = SERIES_DEVIATIONS * math.sqrt(k_factor)
    orders = np.arange(max(0.0, math.floor(k_factor - spread)), k_factor + spread + 40.0)
    if k_factor > 0.0:
        log_weights = orders * math.log(k_factor) - k_factor - _array(gammaln(orders + 1.0))
        weights = np.exp(log_weights)
    else:
        weights = np.where(orders == 0.0, 1.0, 0.0)
    means = _array(psi(orders + 1.0))
    mean = float(weights @ means)
    variance = float(weights @ (_array(zeta(2.0, orders + 1.0)) + (means - mean) ** 2))
    return DB_PER_NEPER * (mean - math.log1p(k_factor)), DB_PER_NEPER * math.sqrt(variance)


def _array(values: object) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
