"""Parameters, checks of arguments, path loss and the kernel."""

import math
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from scipy.spatial.distance import cdist
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from planopt import InputError
from planopt.channel import ChannelParameters, Station, scattered_field_db, shadow_field_db
from planopt.channel.measurements import pairwise_distance_m, shadow_covariance_db2
from planopt.channel.parameters import (
    MIN_DISTANCE_M,
    PRIOR_N_PL,
    PRIOR_N_PL_STD,
    mean_model,
    regressors,
    require_count,
    require_finite,
    require_places,
    station_distance_m,
)

CHANNEL = ChannelParameters(-30.0, 2.5, 4.0, 20.0, 2.0, Station((0.0, 0.0)))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("k_pl_db", math.nan),
        ("n_pl", math.inf),
        ("shadow_std_db", -1.0),
        ("shadow_std_db", math.nan),
        ("decorrelation_m", 0.0),
        ("decorrelation_m", math.inf),
        ("multipath_std_db", -1.0),
        ("forgetting_s", 0.0),
        ("forgetting_s", math.nan),
    ],
)
def test_no_such_channel(name, value):
    """The error names the parameter."""
    with pytest.raises(InputError) as caught:
        replace(CHANNEL, **{name: value})
    assert caught.value.key == name


def test_what_may_be_zero_or_endless():
    """No shadowing, no multipath, no drift, and power that rises with distance."""
    still = ChannelParameters(0.0, -1.0, 0.0, 1.0, 0.0, Station((0.0, 0.0), -2.0))
    assert math.isinf(still.forgetting_s)


@pytest.mark.parametrize(
    ("position_m", "height_m"),
    [((math.nan, 0.0), 0.0), ((0.0, math.inf), 0.0), ((0.0, 0.0), math.nan), ((1e160, 0.0), 0.0)],
)
def test_no_such_place(position_m, height_m):
    """A station is somewhere."""
    with refused():
        Station(position_m, height_m)


def test_what_is_not_is_named():
    """The key stands in the message."""
    with refused():
        require_places(np.zeros((1, 2)), 2)
    with refused():
        require_places(np.array([[0.0, -1e160]]))
    with refused():
        require_finite(float("nan"), "threshold_dbm")
    with refused():
        require_count(0, "count")


@pytest.mark.parametrize(
    ("std", "beta", "cell", "key"),
    [
        (-1.0, 5.0, 1.0, "shadow_std_db"),
        (np.nan, 5.0, 1.0, "shadow_std_db"),
        (4.0, 0.0, 1.0, "decorrelation_m"),
        (4.0, -5.0, 1.0, "decorrelation_m"),
        (4.0, np.inf, 1.0, "decorrelation_m"),
        (4.0, 5.0, 0.0, "cell_m"),
    ],
)
def test_what_is_no_field_is_refused(std, beta, cell, key):
    """By its name, on a lattice and at places."""
    generator = np.random.default_rng(0)
    with pytest.raises(InputError) as caught:
        shadow_field_db((4, 4), cell, std, beta, generator)
    assert caught.value.key == key
    if key != "cell_m":
        with pytest.raises(InputError) as caught:
            scattered_field_db(np.zeros((2, 2)), std, beta, generator)
        assert caught.value.key == key


def test_distance_is_three_dimensional():
    """A 3-4-12 box has the diagonal 13."""
    station = Station((100.0, 50.0), 12.0)
    assert station_distance_m(np.array([[103.0, 54.0]]), station)[0] == 13.0


def test_ten_times_the_distance_costs_ten_n_db():
    """Rows are [1, -10 log10 d]."""
    rows = regressors(np.array([[1.0, 0.0], [10.0, 0.0], [0.0, -100.0]]), Station((0.0, 0.0)))
    np.testing.assert_allclose(rows, [[1.0, 0.0], [1.0, -10.0], [1.0, -20.0]], atol=1e-12)


def test_at_the_station_the_logarithm_stays_finite():
    """Distances do not fall below the least one."""
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
