"""Generalised least squares of Gaussian measurements, and their restricted log likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import log_determinant, lower_factor, solve_lower


@dataclass(frozen=True)
class GeneralisedLeastSquares:
    """The mean of measurements whose covariance is L L'.

    Attributes
    ----------
    coefficients, covariance
        ``(p,)`` of the mean, and M = (G' V^-1 G)^-1, ``(p, p)``.
    lower
        ``(n, n)`` L.
    half_residual
        ``(n,)`` L^-1 (y - G coefficients).
    log_likelihood
        The restricted log likelihood, constants included.
    """

    coefficients: NDArray[np.float64]
    covariance: NDArray[np.float64]
    lower: NDArray[np.float64]
    half_residual: NDArray[np.float64]
    log_likelihood: float


def generalised_least_squares(
    covariance: NDArray[np.float64], columns: NDArray[np.float64], values: NDArray[np.float64]
) -> GeneralisedLeastSquares:
    """Fit `columns` ``(n, p)`` to `values` ``(n,)`` of a positive definite `covariance`."""
    lower = lower_factor(covariance)
    half_columns = solve_lower(lower, columns)
    half_values = solve_lower(lower, values)
    information = half_columns.T @ half_columns
    inverse_information = np.asarray(np.linalg.inv(information), dtype=np.float64)
    coefficients = inverse_information @ (half_columns.T @ half_values)
    residual = half_values - half_columns @ coefficients
    freedom = len(values) - columns.shape[1]
    log_likelihood = float(
        -0.5
        * (
            log_determinant(lower)
            + float(np.linalg.slogdet(information)[1])
            + float(residual @ residual)
            + freedom * np.log(2.0 * np.pi)
        )
    )
    return GeneralisedLeastSquares(
        coefficients, inverse_information, lower, residual, log_likelihood
    )
