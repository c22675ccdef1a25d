"""The factor of singular covariances, by multiplying it out."""

import numpy as np
import pytest

from planopt import InputError
from planopt.channel.cholesky import semidefinite_factor


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_product_is_the_covariance(rank):
    """Any rank, zero included rows: L L' gives the matrix back."""
    root = np.random.default_rng(rank).standard_normal((6, rank))
    root[2] = 0.0
    covariance = root @ root.T
    lower = semidefinite_factor(covariance)
    np.testing.assert_array_equal(lower, np.tril(lower))
    np.testing.assert_allclose(lower @ lower.T, covariance, atol=1e-4)


def test_regular_matrix_gives_the_cholesky_factor():
    """Nothing is lost where the matrix is regular."""
    covariance = np.array([[4.0, 1.0], [1.0, 3.0]])
    np.testing.assert_array_equal(semidefinite_factor(covariance), np.linalg.cholesky(covariance))


@pytest.mark.parametrize("covariance", [[[1.0, 2.0], [2.0, 1.0]], [[-1.0]], [[0.0, 1], [1, 0.0]]])
def test_not_a_covariance(covariance):
    """Matrices with a negative eigenvalue are refused."""
    with pytest.raises(InputError, match="not a covariance"):
        semidefinite_factor(np.array(covariance))
