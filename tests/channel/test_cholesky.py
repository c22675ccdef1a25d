"""Linear algebra against NumPy's, factors of singular covariances, one BLAS thread."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from planopt.channel.cholesky import (
    inverse,
    log_determinant,
    lower_factor,
    one_blas_thread,
    semidefinite_factor,
    solve_lower,
    solve_upper,
)


def test_agrees_with_numpy():
    """Factors, solutions, inverse and determinant; what is no covariance is refused."""
    root = np.random.default_rng(0).standard_normal((6, 6))
    matrix = root @ root.T + np.eye(6)
    lower = lower_factor(matrix)
    np.testing.assert_allclose(lower, np.linalg.cholesky(matrix), rtol=1e-12)
    np.testing.assert_allclose(lower @ solve_lower(lower, root), root, atol=1e-12)
    np.testing.assert_allclose(lower.T @ solve_upper(lower, root), root, atol=1e-12)
    np.testing.assert_allclose(inverse(lower), np.linalg.inv(matrix), atol=1e-12)
    assert log_determinant(lower) == pytest.approx(np.linalg.slogdet(matrix)[1])
    with pytest.raises(AssertionError):
        lower_factor(np.diag([1.0, -1.0]))
    covariance = np.array([[4.0, 1.0], [1.0, 3.0]])
    np.testing.assert_array_equal(semidefinite_factor(covariance), np.linalg.cholesky(covariance))


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_product_is_the_covariance(rank):
    """Any rank, zero included rows: L L' gives the matrix back."""
    root = np.random.default_rng(rank).standard_normal((6, rank))
    root[2] = 0.0
    covariance = root @ root.T
    lower = semidefinite_factor(covariance)
    np.testing.assert_array_equal(lower, np.tril(lower))
    np.testing.assert_allclose(lower @ lower.T, covariance, atol=1e-4)


def threads():
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_one_inside_and_as_before_outside():
    """As a context manager and as a decorator, nested, and after an error."""
    decorated = one_blas_thread()(threads)
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        assert decorated() == {1}
        try:
            with one_blas_thread(), one_blas_thread():
                assert threads() == {1}
                raise ValueError
        except ValueError:
            assert threads() == before
