"""Which measurements are taken for a path, and what they predict."""

import dataclasses

import numpy as np
import pytest
from path_scene import CHANNEL, NOTHING, PATH, drawn

from planopt.channel.kriging import predict
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import regressors
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.objectives.local_channel import local_channel, local_grid

DATA = drawn(200, side_m=80.0)
POSTERIOR = condition(CHANNEL, DATA)


def predicted(channel, places):
    """Mean and deviation from the numbers, as the class says."""
    phi = shadow_covariance_db2(channel.positions_m, places, CHANNEL, channel.blur_m2[:, None])
    gamma = regressors(places, CHANNEL.station)
    mean = gamma @ channel.theta + phi.T @ (channel.weights - channel.trend @ channel.theta)
    b = gamma - phi.T @ channel.trend
    variance = 29.0 - (phi * (channel.precision @ phi)).sum(axis=0)
    return mean, np.sqrt(variance + ((b @ channel.theta_covariance) * b).sum(axis=1))


def test_all_measurements_give_the_exact_posterior():
    """Asked for as many as there are, or more."""
    for count in (200, 999):
        channel = local_channel(POSTERIOR, PATH, count)
        assert len(channel.weights) == 200
        mean, deviation = predicted(channel, PATH)
        expected = predict(POSTERIOR, PATH)
        np.testing.assert_allclose(mean, expected.mean_db, atol=1e-9)
        np.testing.assert_allclose(deviation, expected.deviation_db, atol=1e-9)


def test_a_few_near_ones_are_nearly_exact():
    """64 of 200: within 0.1 dB on the path."""
    mean, deviation = predicted(local_channel(POSTERIOR, PATH, 64), PATH)
    expected = predict(POSTERIOR, PATH)
    assert np.abs(mean - expected.mean_db).max() < 0.1
    assert np.abs(deviation - expected.deviation_db).max() < 0.1


def test_no_place_is_left_out():
    """A cluster at one end does not take the others' share: each place has its four nearest."""
    rng = np.random.default_rng(0)
    cluster = PATH[0] + 0.1 * rng.standard_normal((100, 2))
    positions = np.vstack([cluster, DATA.positions_m])
    whole = Measurements(positions, np.zeros(300), np.zeros(300, dtype=bool))
    found = local_channel(condition(CHANNEL, whole), PATH, 20).positions_m
    assert len(found) == 20
    chosen = {tuple(each) for each in found}
    for place in PATH:
        away = np.linalg.norm(positions - place, axis=1)
        assert {tuple(each) for each in positions[np.argsort(away)[:4]]} <= chosen


def test_position_errors_and_age_are_counted():
    """A channel that forgets, measured at uncertain places, predicts what the posterior does."""
    rng = np.random.default_rng(1)
    aged = dataclasses.replace(
        DATA, position_std_m=rng.uniform(0.0, 3.0, 200), time_s=rng.uniform(0.0, 100.0, 200)
    )
    posterior = condition(dataclasses.replace(CHANNEL, forgetting_s=60.0), aged)
    mean, deviation = predicted(local_channel(posterior, PATH, 200), PATH)
    expected = predict(posterior, PATH)
    np.testing.assert_allclose(mean, expected.mean_db, atol=1e-8)
    np.testing.assert_allclose(deviation, expected.deviation_db, atol=1e-8)


def test_no_measurements():
    """The prior, with arrays of no rows."""
    channel = local_channel(condition(CHANNEL, NOTHING), PATH, 64)
    assert channel.precision.shape == (0, 0) and channel.trend.shape == (0, 2)
    mean, deviation = predicted(channel, PATH)
    expected = predict(condition(CHANNEL, NOTHING), PATH)
    np.testing.assert_allclose(mean, expected.mean_db)
    np.testing.assert_allclose(deviation, expected.deviation_db)


def test_grid():
    """U^-1 Phi and the trend of places, and roots of weights."""
    grid = np.array([[5.0, 5.0], [30.0, 20.0]])
    channel = local_channel(POSTERIOR, PATH, 50)
    found = local_grid(channel, grid, np.array([4.0, 0.25]))
    np.testing.assert_array_equal(found.root_weight, [2.0, 0.5])
    phi = shadow_covariance_db2(channel.positions_m, grid, CHANNEL)
    np.testing.assert_allclose(found.solved, channel.precision @ phi)
    np.testing.assert_allclose(
        found.trend, regressors(grid, CHANNEL.station) - phi.T @ channel.trend
    )


@pytest.mark.parametrize("count", [0, -3])
def test_too_few(count):
    """At least one is asked for."""
    with pytest.raises(InputError):
        local_channel(POSTERIOR, PATH, count)
