# pyright: basic
"""Cholesky factors with types: the boundary to SciPy's linear algebra, which ships none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_blas_funcs, get_lapack_funcs, solve_triangular

# By name: they exist in the compiled module alone, where a type checker cannot see them.
FACTOR, INVERT = get_lapack_funcs(("potrf", "potri"), dtype=np.float64)
(SOLVE,) = get_blas_funcs(("trsm",), dtype=np.float64)


def lower_factor(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower triangular L with L L' = `matrix`, symmetric and positive definite; (n, n)."""
    factor, info = FACTOR(matrix, lower=True)
    if info != 0:
        raise AssertionError("a covariance with a nugget is positive definite")
    return factor


def solve_lower(lower: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """L^-1 `right`, for `right` (n,) or (n, m)."""
    return solve_triangular(lower, right, lower=True, check_finite=False)


def solve_rows(lower: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """Replace each of `rows` (m, n) by L^-1 of it, without a copy of them.

    Parameters
    ----------
    lower
        ``(n, n)`` in Fortran's order, or it is copied.
    rows
        ``(m, n)`` in C's order.
    """
    solved = SOLVE(1.0, lower, rows.T, lower=1, overwrite_b=1)
    if not np.shares_memory(solved, rows):
        raise AssertionError("rows in C's order are solved in place")


def solve_lower_single(
    lower: NDArray[np.float32], right: NDArray[np.float32]
) -> NDArray[np.float32]:
    """L^-1 `right` in single precision, for `right` (n, m)."""
    return solve_triangular(lower, right, lower=True, check_finite=False)


def solve_upper(lower: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """L'^-1 `right`, for `right` (n,) or (n, m)."""
    return solve_triangular(lower, right, lower=True, trans=1, check_finite=False)


def inverse(lower: NDArray[np.float64]) -> NDArray[np.float64]:
    """(L L')^-1, symmetric; (n, n)."""
    half, _ = INVERT(lower, lower=True)
    return half + np.tril(half, -1).T


def log_determinant(lower: NDArray[np.float64]) -> float:
    """The logarithm of |L L'|."""
    return 2.0 * float(np.log(np.diag(lower)).sum())
