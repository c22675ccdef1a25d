"""Joint laws for a posterior without a factor: from the measurements near."""

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, START, drawn

from planopt.channel.kriging import predict
from planopt.channel.posterior import condition, factored_near
from planopt.objectives.mapping import Region, average_reduction, path_information
from planopt.objectives.path_loss_learning import Criterion, path_loss_value
from planopt.objectives.until_connected import Search, expected_distance_m

DATA = drawn(900, side_m=150.0)
WHOLE = condition(CHANNEL, DATA)
MANY = condition(CHANNEL, DATA, exact_limit=100)


def test_with_a_factor_it_is_the_posterior_itself():
    """Nothing is computed."""
    assert factored_near(WHOLE, PATH) is WHOLE


def test_without_one_the_near_measurements_are_factorised():
    """512 of 900 and more, theta and its covariance those of all; 1e-3 dB."""
    assert not MANY.has_factor
    near = factored_near(MANY, PATH)
    assert near.has_factor and 512 <= len(near.measurements) < 900
    np.testing.assert_array_equal(near.theta, MANY.theta)
    np.testing.assert_array_equal(near.theta_covariance, MANY.theta_covariance)
    found, expected = predict(near, PATH), predict(MANY, PATH)
    np.testing.assert_allclose(found.mean_db, expected.mean_db, atol=1e-3)
    np.testing.assert_allclose(found.deviation_db, expected.deviation_db, atol=1e-3)


def test_objectives_agree_with_those_of_all_measurements():
    """Learning, information, average and distance, without a factor and with one."""
    region = Region(np.array([[20.0, 20.0], [30.0, 25.0]]), np.ones(2))
    for value in (
        lambda posterior: path_loss_value(posterior, PATH, Criterion("T")),
        lambda posterior: path_loss_value(posterior, PATH, Criterion("D")),
        lambda posterior: path_information(posterior, PATH),
        lambda posterior: average_reduction(posterior, PATH, region),
    ):
        assert value(MANY) == pytest.approx(value(WHOLE), rel=5e-3)
    level = float(predict(WHOLE, PATH).mean_db.mean()) + 1.0
    distances = [
        expected_distance_m(each, PATH, Search(START, level), np.random.default_rng(0))
        for each in (MANY, WHOLE)
    ]
    assert distances[0] == pytest.approx(distances[1], rel=5e-3)
