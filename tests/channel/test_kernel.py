"""The kernel against scikit-learn and its closed form."""

import numpy as np
from scipy.spatial.distance import cdist
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from planopt.channel import ChannelParameters, Station
from planopt.channel.measurement_covariance import pairwise_distance_m, shadow_covariance_db2

PARAMETERS = ChannelParameters(-40.0, 3.0, 5.0, 20.0, 2.0, Station((0.0, 0.0)))
A = np.random.default_rng(0).uniform(-50.0, 50.0, (7, 2))
B = np.random.default_rng(1).uniform(-50.0, 50.0, (4, 2))


def test_distances_equal_scipys():
    """Every pair, also near 3e6 where an expanded square would lose all digits."""
    np.testing.assert_allclose(pairwise_distance_m(A, B), cdist(A, B), rtol=1e-13)
    shift = np.array([3e6, 3e6])
    np.testing.assert_allclose(pairwise_distance_m(A + shift, B + shift), cdist(A, B), atol=1e-8)


def test_covariance_equals_scikit_learns():
    """Matern with nu = 1/2, the length scale being beta itself."""
    oracle = ConstantKernel(25.0) * Matern(20.0, nu=0.5)
    np.testing.assert_allclose(shadow_covariance_db2(A, B, PARAMETERS), oracle(A, B), rtol=1e-12)
