"""The typed linear algebra against NumPy's."""

import numpy as np
import pytest

from planopt.channel.cholesky import (
    inverse,
    log_determinant,
    lower_factor,
    solve_lower,
    solve_rows,
    solve_upper,
)


def test_agrees_with_numpy():
    """Factor, solve, inverse and determinant of a random covariance."""
    root = np.random.default_rng(0).standard_normal((6, 6))
    matrix = root @ root.T + np.eye(6)
    lower = lower_factor(matrix)
    np.testing.assert_allclose(lower, np.linalg.cholesky(matrix), rtol=1e-12)
    np.testing.assert_allclose(lower @ solve_lower(lower, root), root, atol=1e-12)
    np.testing.assert_allclose(lower.T @ solve_upper(lower, root), root, atol=1e-12)
    np.testing.assert_allclose(inverse(lower), np.linalg.inv(matrix), atol=1e-12)
    assert log_determinant(lower) == pytest.approx(np.linalg.slogdet(matrix)[1])


def test_rows_are_solved_in_place():
    """Each row by forward substitution, in the caller's array."""
    lower = np.tril(np.random.default_rng(1).uniform(1.0, 2.0, (5, 5)))
    rows = np.random.default_rng(2).standard_normal((7, 5))
    expected = np.linalg.solve(lower, rows.T)
    solve_rows(np.asfortranarray(lower), rows)
    np.testing.assert_allclose(rows, expected.T, atol=1e-12)


def test_a_matrix_that_is_no_covariance_is_refused():
    """An indefinite matrix is a defect of the caller, and is not factored silently."""
    with pytest.raises(AssertionError):
        lower_factor(np.diag([1.0, -1.0]))
