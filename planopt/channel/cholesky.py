# pyright: basic
"""Cholesky factors with types: the boundary to SciPy's linear algebra, which ships none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, solve_triangular


def lower_factor(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower triangular L with L L' = `matrix`, symmetric and positive definite; (n, n)."""
    factor, info = lapack.dpotrf(matrix, lower=True)
    if info != 0:
        raise AssertionError("a covariance with a nugget is positive definite")
    return factor


def solve_lower(lower: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """L^-1 `right`, for `right` (n,) or (n, m)."""
    return solve_triangular(lower, right, lower=True, check_finite=False)


def inverse(lower: NDArray[np.float64]) -> NDArray[np.float64]:
    """(L L')^-1, symmetric; (n, n)."""
    half, _ = lapack.dpotri(lower, lower=True)
    return half + np.tril(half, -1).T


def log_determinant(lower: NDArray[np.float64]) -> float:
    """The logarithm of |L L'|."""
    return 2.0 * float(np.log(np.diag(lower)).sum())
