# pyright: basic
"""Cholesky factors with types: the boundary to SciPy's linear algebra, which ships none.

One BLAS thread for the many small factorisations of an estimate.

The matrices are too small to gain from threads, and on a machine whose cores are busy OpenBLAS
spins while its threads wait for each other: a fit of 102 measurements then took 6 s, not 20 ms.
One thread also makes the result independent of the machine's number of cores.

A Cholesky factor that grows by rows without being copied.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import cache

import numpy as np

# NumPy's and SciPy's BLAS must be loaded before the controller looks for them.
import scipy.linalg  # noqa: F401  # pyright: ignore[reportUnusedImport]
from numpy.typing import NDArray
from scipy.linalg import get_blas_funcs, get_lapack_funcs, solve_triangular
from threadpoolctl import ThreadpoolController

from planopt.errors import InputError

# By name: they exist in the compiled module alone, where a type checker cannot see them.
FACTOR, INVERT, INVERT_LOWER, SOLVE_LOWER = get_lapack_funcs(
    ("potrf", "potri", "trtri", "trtrs"), dtype=np.float64
)
SOLVE, MULTIPLY, SYMMETRIC = get_blas_funcs(("trsm", "trmm", "symm"), dtype=np.float64)

INVERTED_ROWS = 64
"""Of more rows the inverse of a factor is made of those of its halves: LAPACK's own took 2.5 times
as long at 144."""

PUT_ROWS = 64
"""Rows of a factor that are copied together, up to their diagonal."""


def lower_factor(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower triangular L with L L' = `matrix`, symmetric and positive definite; (n, n)."""
    return np.tril(_half_factor(matrix, overwrite=False))


def whitened_by(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """L^-1 `right` (n, m) with the L of :func:`lower_factor`; `matrix` is overwritten."""
    return factor_and_whitened(matrix, right)[1]


def factor_and_whitened(
    matrix: NDArray[np.float64], right: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """L (n, n), with numbers left above its diagonal, and L^-1 `right`; `matrix` is overwritten."""
    factor = _half_factor(matrix, overwrite=True)
    return factor, solve_lower(factor, right)


def put_lower_factor(into: NDArray[np.float64], matrix: NDArray[np.float64]) -> None:
    """Write :func:`lower_factor` of `matrix`, which is overwritten, to the zeros `into` (n, n)."""
    factor = _half_factor(matrix, overwrite=True)
    for start in range(0, len(into), PUT_ROWS):
        rows = slice(start, start + PUT_ROWS)
        into[rows, :start] = factor[rows, :start]
        into[rows, rows] = np.tril(factor[rows, rows])


def _half_factor(matrix: NDArray[np.float64], overwrite: bool) -> NDArray[np.float64]:
    """L in C's order, numbers of `matrix` left above its diagonal.

    LAPACK is given the transpose, which is the same matrix and in its own order, and does not clear
    the other half: at 512 rows these two take as long as the factor.
    """
    factor, info = FACTOR(matrix.T, lower=False, clean=False, overwrite_a=overwrite)
    if info != 0:
        raise AssertionError("a covariance with a nugget is positive definite")
    return factor.T


def solve_lower(lower: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """L^-1 `right`, for `right` (n,) or (n, m)."""
    # SciPy's wrapper costs more than the solution of a small system. A factor in C's order is
    # passed as its transpose, as there, since it would be copied otherwise.
    if not right.size:
        return np.zeros_like(right)
    if lower.flags.f_contiguous:
        return SOLVE_LOWER(lower, right, lower=1)[0]
    return SOLVE_LOWER(lower.T, right, lower=0, trans=1)[0]


def solve_rows(lower: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """Replace each of `rows` (m, n) by L^-1 of it, without a copy of them."""
    # Shapes: lower (n, n); rows (m, n).
    solved = SOLVE(1.0, lower, rows.T, lower=1, overwrite_b=1)
    if not np.shares_memory(solved, rows):
        raise AssertionError("rows in C's order are solved in place")


def multiply_rows(lower: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """Replace each of `rows` (m, n) by L times it; `lower` and `rows` as in :func:`solve_rows`."""
    product = MULTIPLY(1.0, lower, rows.T, lower=1, overwrite_b=1)
    if not np.shares_memory(product, rows):
        raise AssertionError("rows in C's order are multiplied in place")


def lower_inverse(lower: NDArray[np.float64]) -> NDArray[np.float64]:
    """L^-1, lower triangular, in Fortran's order; (n, n)."""
    inverted, info = INVERT_LOWER(lower, lower=1)
    if info != 0:
        raise AssertionError("a Cholesky factor has no zero on its diagonal")
    return inverted


def factor_and_inverse(
    matrix: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The diagonal of L and L^-1, L as of :func:`lower_factor`; (n,) and (n, n).

    Fast for some hundred rows.
    """
    lower, info = FACTOR(matrix.T, lower=True, clean=True)
    if info != 0:
        raise AssertionError("a covariance with a nugget is positive definite")
    return np.diag(lower), _halved_inverse(lower)


def _halved_inverse(lower: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(lower) <= INVERTED_ROWS:
        return lower_inverse(lower)
    half = len(lower) // 2
    first, last = _halved_inverse(lower[:half, :half]), _halved_inverse(lower[half:, half:])
    inverted = np.zeros(lower.shape, order="F")
    inverted[:half, :half], inverted[half:, half:] = first, last
    inverted[half:, :half] = -(last @ (lower[half:, :half] @ first))
    return inverted


def solve_upper(lower: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """L'^-1 `right`, for `right` (n,) or (n, m)."""
    return solve_triangular(lower, right, lower=True, trans=1, check_finite=False)


def half_inverse(matrix: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Log |matrix|, and the upper half of its inverse with zeros below; `matrix` is overwritten."""
    lower, info = FACTOR(matrix.T, lower=True, clean=True, overwrite_a=True)
    if info != 0:
        raise AssertionError("a covariance with a nugget is positive definite")
    determinant = log_determinant(lower)
    half, _ = INVERT(lower, lower=True, overwrite_c=True)
    return determinant, half.T


def symmetric_product(
    half: NDArray[np.float64], columns: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Product of a symmetric matrix, of which `half` is the upper half, and `columns` (n, m)."""
    return SYMMETRIC(1.0, half.T, columns, lower=1)


def inverse(lower: NDArray[np.float64]) -> NDArray[np.float64]:
    """(L L')^-1, symmetric; (n, n)."""
    if not len(lower):
        # LAPACK complains of nothing on the terminal.
        return np.zeros_like(lower)
    half, _ = INVERT(lower, lower=True)
    return half + np.tril(half, -1).T


def log_determinant(lower: NDArray[np.float64]) -> float:
    """The logarithm of |L L'|."""
    return 2.0 * float(np.log(np.diag(lower)).sum())


DETERMINED = 1e-10
"""A value counts as determined by earlier ones while its variance given them is below this share
of the largest variance: far above rounding, far below any variance of interest."""


def semidefinite_factor(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower triangular L with L L' = `covariance`; columns of determined values are zero."""
    # Shapes: covariance (h, h).
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
    # What a determined value leaves undone is at most the root of its own remaining variance.
    if not np.abs(lower @ lower.T - covariance).max() <= 2.0 * np.sqrt(DETERMINED) * abs(scale):
        raise InputError(
            "the matrix is not a covariance: it is not positive semidefinite", key="covariance_db2"
        )
    return lower


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Limit BLAS to one thread inside; a context manager, or a decorator when called."""
    with _controller().limit(limits=1, user_api="blas"):  # pyright: ignore[reportUnknownMemberType]
        yield


@cache
def _controller() -> ThreadpoolController:
    """Finding the loaded libraries takes milliseconds, so once is enough."""
    return ThreadpoolController()


SOLVE_BLOCK = 136
"""Rows of powers of two meet in a few lines of the processor's cache: 256 took up to twice as
long."""


def unwhiten(lower: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """L'^-1 `columns` (n, m), by blocks as :func:`whiten`; after it, U^-1 of what was whitened."""
    solved = np.array(columns, dtype=np.float64)
    for start in range((len(lower) - 1) // SOLVE_BLOCK * SOLVE_BLOCK, -1, -SOLVE_BLOCK):
        rows, below = slice(start, start + SOLVE_BLOCK), slice(start + SOLVE_BLOCK, None)
        solved[rows] -= lower[below, rows].T @ solved[below]
        solved[rows] = solve_upper(lower[rows, rows], solved[rows])
    return solved


def whiten(lower: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """L^-1 `columns` (n, m), by blocks, because LAPACK would copy a view of a larger buffer."""
    solved = np.array(columns, dtype=np.float64)
    for start in range(0, len(lower), SOLVE_BLOCK):
        rows = slice(start, start + SOLVE_BLOCK)
        solved[rows] -= lower[rows, :start] @ solved[:start]
        solved[rows] = solve_lower(lower[rows, rows], solved[rows])
    return solved
