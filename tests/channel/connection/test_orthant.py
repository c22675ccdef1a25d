"""Prefix probabilities against closed forms and SciPy's multivariate normal distribution."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from planopt.channel.path_connectivity import prefix_probabilities


def rng():
    """A fresh source."""
    return np.random.default_rng(5)


def test_every_prefix_against_scipy():
    """A random covariance of 8; each prefix within the stated error and SciPy's 1e-5."""
    root = np.random.default_rng(0).standard_normal((8, 8))
    covariance, bound = root @ root.T + np.eye(8), np.linspace(-1.0, 4.0, 8)
    found = prefix_probabilities(bound, covariance, rng())
    for k in range(1, 9):
        expected = multivariate_normal.cdf(bound[:k], cov=covariance[:k, :k])
        assert abs(found.probability[k - 1] - expected) <= 2.0 * found.error[k - 1] + 2e-5
    assert found.error.max() <= 1e-4


def test_equicorrelation_of_one_half():
    """P(X <= 0 in all) = 1 / (h + 1) where all correlations are 1/2."""
    found = prefix_probabilities(np.zeros(12), 0.5 + 0.5 * np.eye(12), rng())
    np.testing.assert_allclose(found.probability, 1.0 / np.arange(2.0, 14.0), atol=2e-4)


def test_independent_far_tail():
    """Products that no sampler would hit keep their digits: P = Phi(-20)^3, about 1e-265."""
    found = prefix_probabilities(np.full(3, -20.0), np.eye(3), rng())
    np.testing.assert_allclose(found.probability, norm.cdf(-20.0) ** np.arange(1.0, 4.0), rtol=1e-9)


@pytest.mark.parametrize("far", [1e3, 1e12, 1e160])
def test_bounds_out_of_all_proportion(far):
    """Certain and impossible, without overflow."""
    covariance = 0.5 + 0.5 * np.eye(3)
    bound = np.array([far, -far, far])
    found = prefix_probabilities(bound, covariance, rng())
    np.testing.assert_allclose(found.probability, [1.0, 0.0, 0.0], atol=1e-12)


def test_singular_covariance():
    """A repeated variable changes nothing; a constant is in or out."""
    covariance = np.array([[1.0, 1.0, 0.5], [1.0, 1.0, 0.5], [0.5, 0.5, 1.0]])
    found = prefix_probabilities(np.array([0.3, 0.3, 0.1]), covariance, rng())
    expected = multivariate_normal.cdf([0.3, 0.1], cov=[[1.0, 0.5], [0.5, 1.0]])
    assert found.probability[1] == pytest.approx(norm.cdf(0.3), abs=1e-12)
    assert found.probability[2] == pytest.approx(expected, abs=2e-4)
    constant = np.diag([0.0, 1.0, 0.0])
    inside = prefix_probabilities(np.array([0.1, 0.0, 0.0]), constant, rng())
    np.testing.assert_allclose(inside.probability, [1.0, 0.5, 0.5], atol=1e-12)
    outside = prefix_probabilities(np.array([0.1, 0.0, -0.1]), constant, rng())
    np.testing.assert_allclose(outside.probability, [1.0, 0.5, 0.0], atol=1e-12)


def test_one_variable_is_exact():
    """No randomness is needed for one."""
    found = prefix_probabilities(np.array([2.0]), np.array([[4.0]]), rng())
    assert found.probability[0] == pytest.approx(norm.cdf(1.0), rel=1e-14)
    assert found.error[0] == 0.0


def test_error_estimate_covers():
    """The stated error holds the truth in at least 18 of 20 seeds, at a coarse tolerance."""
    covariance = 0.5 + 0.5 * np.eye(10)
    held = 0
    for seed in range(20):
        found = prefix_probabilities(np.zeros(10), covariance, np.random.default_rng(seed), 1e-2)
        held += abs(found.probability[-1] - 1.0 / 11.0) <= found.error[-1]
    assert held >= 18


def test_tolerance_out_of_reach_ends():
    """The last lattice's answer comes with the error it has."""
    found = prefix_probabilities(np.zeros(3), 0.5 + 0.5 * np.eye(3), rng(), 1e-300)
    assert 0.0 < found.error[-1] < 1e-5
    assert found.probability[-1] == pytest.approx(0.25, abs=1e-5)
