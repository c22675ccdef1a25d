"""Path loss by least squares (seed, Lemma 1), with censored powers completed by expectation.

With no censored measurement this is Lemma 1's theta-hat and alpha-hat. Censored powers are
replaced by their expected values given that they are at most the floor, under the line and
independent normal deviations of variance alpha, and the line is refitted until neither moves: the
EM algorithm of Tobit regression. It ignores that shadowing is correlated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.kernel import pairwise_distance_m
from planopt.channel.mean_model import MeanModel
from planopt.channel.measurements import Measurements

MAX_SWEEPS = 500
TOLERANCE_DB = 1e-6
"""The line has converged when no fitted value moves by more."""

ROWS = 512
"""Rows of the covariance that are held at once."""


@dataclass(frozen=True)
class LeastSquares:
    """A fitted line.

    Attributes
    ----------
    coefficients
        ``(p,)`` of the mean model (theta-hat for p = 2).
    residual_db
        ``(n,)`` completed power minus the line (the seed's Y_c).
    variance_db2
        alpha-hat: mean square of the residual, plus what censoring hides; divided by n as printed.
    """

    coefficients: NDArray[np.float64]
    residual_db: NDArray[np.float64]
    variance_db2: float


def least_squares(model: MeanModel, measurements: Measurements) -> LeastSquares:
    """Fit the line. At least one measurement must be uncensored."""
    power = measurements.power_dbm - model.offset_db
    inverse = np.linalg.pinv(model.columns)
    censored = measurements.censored
    exact = ~censored
    limit = power[censored]
    # Start from the uncensored line, so that floors do not flatten the slope.
    coefficients = np.linalg.pinv(model.columns[exact]) @ power[exact]
    variance = float(np.mean((power[exact] - model.columns[exact] @ coefficients) ** 2))
    completed = power.copy()
    hidden = 0.0
    for _ in range(MAX_SWEEPS):
        before = model.columns @ coefficients
        completed[censored], variances = _expected_below(limit, before[censored], variance)
        hidden = float(variances.sum())
        coefficients = inverse @ completed
        fitted = model.columns @ coefficients
        variance = float((((completed - fitted) ** 2).sum() + hidden) / len(power))
        if np.abs(fitted - before).max() < TOLERANCE_DB:
            break
    return LeastSquares(coefficients, completed - model.columns @ coefficients, variance)


def coefficient_covariance(
    model: MeanModel,
    positions_m: NDArray[np.float64],
    shadow_variance_db2: float,
    decorrelation_m: float,
    multipath_variance_db2: float,
) -> NDArray[np.float64]:
    """Covariance of the least-squares coefficients under correlated shadowing; (p, p).

    (G'G)^-1 G' U G (G'G)^-1 with U = xi^2 exp(-d / beta) + omega^2 I; the usual
    alpha (G'G)^-1 is several times too small where beta spans many measurements.
    """
    columns = model.columns
    middle = multipath_variance_db2 * columns.T @ columns
    for first in range(0, len(columns), ROWS):
        rows = slice(first, first + ROWS)
        distance = pairwise_distance_m(positions_m[rows], positions_m)
        block = shadow_variance_db2 * np.exp(-distance / decorrelation_m)
        middle += columns[rows].T @ block @ columns
    outer = np.linalg.pinv(columns.T @ columns)
    return outer @ middle @ outer


def _expected_below(
    limit: NDArray[np.float64], mean: NDArray[np.float64], variance: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and variance of N(mean, variance) given that the value is at most `limit`; (m,) each."""
    deviation = np.sqrt(max(variance, 1e-12))
    z = (limit - mean) / deviation
    log_below = np.asarray(log_ndtr(z), dtype=np.float64)
    hazard = np.exp(-0.5 * z * z - 0.5 * np.log(2.0 * np.pi) - log_below)
    shrink = np.clip(hazard * (z + hazard), 0.0, 1.0)
    # The clip holds the expectation below its limit where the ratio loses its digits.
    return np.minimum(mean - deviation * hazard, limit), deviation**2 * (1.0 - shrink)
