"""Which part of theta is estimated, and what the other contributes."""

import numpy as np
import pytest

from planopt.channel import Station
from planopt.channel.parameters import PRIOR_N_PL, PRIOR_N_PL_STD, mean_model, regressors

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
