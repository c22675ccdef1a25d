"""Local kriging against the exact posterior."""

from itertools import pairwise

import numpy as np
import pytest
from local_kriging import predict_locally

from planopt.channel.kriging import predict
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.neighbours import neighbour_model
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition

PARAMETERS = ChannelParameters(-40.0, 3.0, 4.0, 20.0, 1.13, Station((5.0, -10.0), 12.0))


def posterior_of(count, seed=0):
    """A posterior of smooth random data on a 100 m square."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(0.0, 100.0, (count, 2))
    power = -80.0 + 4.0 * np.sin(positions[:, 0] / 15.0) + generator.standard_normal(count)
    return condition(PARAMETERS, Measurements(positions, power, np.zeros(count, dtype=bool)))


CENTRES = np.random.default_rng(8).uniform(0.0, 100.0, (25, 2))


@pytest.mark.parametrize("available", [0, 1, 20, 60])
def test_all_measurements_give_the_exact_posterior(available):
    """With count at or above what there is, padded or not, prediction is exact to 1e-9."""
    posterior = posterior_of(available)
    model = neighbour_model(posterior, CENTRES, 60)
    assert model.positions_m.shape == (25, 60, 2)
    assert model.precision.shape == (25, 60, 60)
    assert model.weights.shape == (25, 60)
    assert model.trend.shape == (25, 60, 2)
    places = CENTRES + 2.0
    found = predict_locally(model, places)
    exact = predict(posterior, places)
    np.testing.assert_allclose(found.mean_db, exact.mean_db, atol=1e-9)
    np.testing.assert_allclose(found.deviation_db, exact.deviation_db, atol=1e-9)


def test_accuracy_of_48_of_1000():
    """4 m away from the centres the mean is off by 0.1 dB rms at most, the deviation by 0.01."""
    posterior = posterior_of(1000)
    model = neighbour_model(posterior, CENTRES, 48)
    places = CENTRES + 4.0 / np.sqrt(2.0)
    found = predict_locally(model, places)
    exact = predict(posterior, places)
    assert np.sqrt(np.mean((found.mean_db - exact.mean_db) ** 2)) < 0.1
    assert np.abs(found.deviation_db - exact.deviation_db).max() < 0.01


def test_fewer_measurements_never_lower_the_deviation():
    """With theta known, kriging from a subset is a posterior of less data."""
    generator = np.random.default_rng(1)
    positions = generator.uniform(0.0, 100.0, (300, 2))
    data = Measurements(positions, -80.0 + positions[:, 0] / 20.0, np.zeros(300, dtype=bool))
    posterior = condition(PARAMETERS, data, theta="known")
    deviations = [
        predict_locally(neighbour_model(posterior, CENTRES, count), CENTRES + 1.0).deviation_db
        for count in (4, 16, 48, 300)
    ]
    for fewer, more in pairwise(deviations):
        assert (fewer >= more - 1e-12).all()
