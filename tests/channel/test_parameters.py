"""Parameters, checks of arguments, path loss and the kernel."""

import math

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from planopt.channel import ChannelParameters, Station
from planopt.channel.measurements import pairwise_distance_m, shadow_covariance_db2
from planopt.channel.parameters import (
    MIN_DISTANCE_M,
    PRIOR_N_PL,
    PRIOR_N_PL_STD,
    mean_model,
    regressors,
    station_distance_m,
)

CHANNEL = ChannelParameters(-30.0, 2.5, 4.0, 20.0, 2.0, Station((0.0, 0.0)))


def test_what_may_be_zero_or_endless():
    """No shadowing, no multipath, no drift, and power that rises with distance."""
    still = ChannelParameters(0.0, -1.0, 0.0, 1.0, 0.0, Station((0.0, 0.0), -2.0))
    assert math.isinf(still.forgetting_s)


def test_columns_of_path_loss():
    """Rows are [1, -10 log10 d]; the distance in space never falls below the least one."""
    station = Station((100.0, 50.0), 12.0)
    assert station_distance_m(np.array([[103.0, 54.0]]), station)[0] == 13.0
    rows = regressors(np.array([[1.0, 0.0], [10.0, 0.0], [0.0, -100.0]]), Station((0.0, 0.0)))
    np.testing.assert_allclose(rows, [[1.0, 0.0], [1.0, -10.0], [1.0, -20.0]], atol=1e-12)
    rows = regressors(np.array([[7.0, 7.0]]), Station((7.0, 7.0)))
    assert rows[0, 1] == -10.0 * np.log10(MIN_DISTANCE_M)


STATION = Station((0.0, 0.0))
POSITIONS = np.array([[3.0, 4.0], [6.0, 8.0], [30.0, 40.0]])


def test_one_column_predicts_the_prior_slope():
    """With n_PL assumed, the mean model and theta give the same path loss."""
    model = mean_model(POSITIONS, np.ones(3, bool), STATION, False)
    mean = model.offset_db + model.columns @ np.array([-40.0])
    theta = model.theta(np.array([-40.0]))
    assert theta == (-40.0, PRIOR_N_PL)
    np.testing.assert_allclose(mean, regressors(POSITIONS, STATION) @ theta)


def test_an_assumed_slope_pivots_about_the_measurements():
    """The prior's error in n_PL leaves the path loss at the measurements' mean unmoved."""
    exact = np.array([True, True, False])
    model = mean_model(POSITIONS, exact, STATION, False)
    covariance = model.theta_covariance(np.array([[0.25]]))
    pivot = regressors(POSITIONS[exact], STATION).mean(axis=0)
    assert pivot @ covariance @ pivot == pytest.approx(0.25)
    assert covariance[1, 1] == PRIOR_N_PL_STD**2


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
