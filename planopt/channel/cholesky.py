# pyright: basic
"""Typed wrappers of LAPACK's Cholesky factorisations and triangular solves.

On a busy machine, waiting BLAS threads made a fit of 102 measurements take 6 s instead of 20 ms.
"""

from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from typing import Any, cast

import numpy as np

# NumPy's and SciPy's BLAS must be loaded before the controller searches for them.
import scipy.linalg  # noqa: F401  # pyright: ignore[reportUnusedImport]
from scipy.linalg import get_blas_funcs, get_lapack_funcs, solve_triangular
from threadpoolctl import ThreadpoolController

from planopt.arrays import Floats
from planopt.errors import InputError

# Looked up by name, because a type checker cannot see into the compiled module.
FACTOR, INVERT, INVERT_LOWER, SOLVE_LOWER = cast("Any", get_lapack_funcs)(
    ("potrf", "potri", "trtri", "trtrs"), dtype=np.float64
)
SYMMETRIC = get_blas_funcs("symm", dtype=np.float64)

INVERTED_ROWS = 64
"""Maximum number of rows that LAPACK inverts directly; more are inverted faster by halves."""
PUT_ROWS = 64  # Number of rows of a factor copied at once, which avoids copying the unused half


def lower_factor(matrix: Floats) -> Floats:
    """Return the lower Cholesky factor L (n, n) of a positive definite `matrix` = L L'."""
    return np.tril(_half_factor(matrix, overwrite=False))


def whitened_by(matrix: Floats, right: Floats) -> Floats:
    """Overwrite `matrix` and return L^-1 `right` (n, m), with L its lower Cholesky factor."""
    return factor_and_whitened(matrix, right)[1]


def factor_and_whitened(matrix: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Overwrite `matrix`; return its factor L, undefined above the diagonal, and L^-1 `right`."""
    factor = _half_factor(matrix, overwrite=True)
    return factor, solve_lower(factor, right)


def put_lower_factor(into: Floats, matrix: Floats) -> None:
    """Overwrite `matrix`; write its Cholesky factor to the zero array `into` (n, n)."""
    factor = _half_factor(matrix, overwrite=True)
    for start in range(0, len(into), PUT_ROWS):
        rows = slice(start, start + PUT_ROWS)
        into[rows, :start] = factor[rows, :start]
        into[rows, rows] = np.tril(factor[rows, rows])


def _half_factor(matrix: Floats, overwrite: bool) -> Floats:
    """Return the Cholesky factor L of `matrix` in C order, undefined above the diagonal."""
    # LAPACK gets the transpose: a copy would take as long as the factorisation at 512 rows.
    factor, info = FACTOR(matrix.T, lower=False, clean=False, overwrite_a=overwrite)
    if info != 0:
        raise AssertionError("a covariance with a nugget is positive definite")
    return factor.T


def solve_lower(lower: Floats, right: Floats) -> Floats:
    """Solve L x = `right` for a lower triangular L; `right` is (n,) or (n, m)."""
    # SciPy's wrapper costs more than a small system; the transpose of a factor avoids a copy.
    if not right.size:
        return np.zeros_like(right)
    if lower.flags.f_contiguous:
        return SOLVE_LOWER(lower, right, lower=1)[0]
    return SOLVE_LOWER(lower.T, right, lower=0, trans=1)[0]


def lower_inverse(lower: Floats) -> Floats:
    """Return the inverse of a lower triangular matrix in Fortran order as an array (n, n)."""
    inverted, info = INVERT_LOWER(lower, lower=1)
    if info != 0:
        raise AssertionError("a Cholesky factor has no zero on its diagonal")
    return inverted


def factor_and_inverse(matrix: Floats) -> tuple[Floats, Floats]:
    """Return the diagonal (n,) of L, and L^-1 (n, n); L is the Cholesky factor of `matrix`."""
    lower, info = FACTOR(matrix.T, lower=True, clean=True)
    if info != 0:
        raise AssertionError("a covariance with a nugget is positive definite")
    return np.diag(lower), _halved_inverse(lower)


def _halved_inverse(lower: Floats) -> Floats:
    if len(lower) <= INVERTED_ROWS:
        return lower_inverse(lower)
    half = len(lower) // 2
    first, last = _halved_inverse(lower[:half, :half]), _halved_inverse(lower[half:, half:])
    inverted = np.zeros(lower.shape, order="F")
    inverted[:half, :half], inverted[half:, half:] = first, last
    inverted[half:, :half] = -(last @ (lower[half:, :half] @ first))
    return inverted


def solve_upper(lower: Floats, right: Floats) -> Floats:
    """Solve L' x = `right` for a lower triangular L; `right` is (n,) or (n, m)."""
    return solve_triangular(lower, right, lower=True, trans=1, check_finite=False)


def half_inverse(matrix: Floats) -> tuple[float, Floats]:
    """Overwrite `matrix`; return its log-determinant, and the upper half of its inverse."""
    lower, info = FACTOR(matrix.T, lower=True, clean=True, overwrite_a=True)
    if info != 0:
        raise AssertionError("a covariance with a nugget is positive definite")
    determinant = log_determinant(lower)
    half, _ = INVERT(lower, lower=True, overwrite_c=True)
    return determinant, half.T


def symmetric_product(half: Floats, columns: Floats) -> Floats:
    """Multiply a symmetric matrix, given by its upper half `half`, by `columns` (n, m)."""
    return SYMMETRIC(1.0, half.T, columns, lower=1)


def inverse(lower: Floats) -> Floats:
    """Return the symmetric inverse of L L' for a lower triangular L as an array (n, n)."""
    if not len(lower):
        # LAPACK prints a warning for an empty matrix.
        return np.zeros_like(lower)
    half, _ = INVERT(lower, lower=True)
    return half + np.tril(half, -1).T


def log_determinant(lower: Floats) -> float:
    """Return the log-determinant of L L' for a lower triangular L."""
    return 2.0 * float(np.log(np.diag(lower)).sum())


DETERMINED = 1e-10
"""Conditional variance, relative to the largest, below which a value is a function of others."""


def semidefinite_factor(covariance: Floats) -> Floats:
    """Return a lower L with L L' = `covariance`; a singular covariance gives zero columns."""
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        pass
    scale = float(np.diag(covariance).max())
    lower = np.zeros_like(covariance)
    for column in range(len(covariance)):
        rest = covariance[column:, column] - lower[column:, :column] @ lower[column, :column]
        if rest[0] > DETERMINED * scale:
            lower[column:, column] = rest / np.sqrt(rest[0])
    # The error of a determined value is at most the root of its remaining variance.
    if not np.abs(lower @ lower.T - covariance).max() <= 2.0 * np.sqrt(DETERMINED) * abs(scale):
        raise InputError(
            "is not a covariance matrix: it has a negative eigenvalue", key="covariance_db2"
        )
    return lower


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Limit BLAS to one thread within a ``with`` block or a decorated function."""
    with _controller().limit(limits=1, user_api="blas"):  # pyright: ignore[reportUnknownMemberType]
        yield


@cache
def _controller() -> ThreadpoolController:
    """Return the cached controller of the BLAS threads, whose construction takes milliseconds."""
    return ThreadpoolController()


SOLVE_BLOCK = 136  # Number of rows solved at once; powers of two cause cache conflicts


def unwhiten(lower: Floats, columns: Floats) -> Floats:
    """Solve L' x = `columns` (n, m) by blocks, as in :func:`whiten`."""
    solved = np.array(columns, dtype=np.float64)
    for start in range((len(lower) - 1) // SOLVE_BLOCK * SOLVE_BLOCK, -1, -SOLVE_BLOCK):
        rows, below = slice(start, start + SOLVE_BLOCK), slice(start + SOLVE_BLOCK, None)
        solved[rows] -= lower[below, rows].T @ solved[below]
        solved[rows] = solve_upper(lower[rows, rows], solved[rows])
    return solved


def whiten(lower: Floats, columns: Floats) -> Floats:
    """Solve L x = `columns` (n, m) by blocks; this avoids a copy of `lower`."""
    solved = np.array(columns, dtype=np.float64)
    for start in range(0, len(lower), SOLVE_BLOCK):
        rows = slice(start, start + SOLVE_BLOCK)
        solved[rows] -= lower[rows, :start] @ solved[:start]
        solved[rows] = solve_lower(lower[rows, rows], solved[rows])
    return solved
