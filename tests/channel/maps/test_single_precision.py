"""Single precision against double: how far off, and that no digits are lost by far-off places."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel.maps.tile_map import predict_single
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition
from planopt.errors import InputError

CHANNEL = ChannelParameters(-10.0, 2.0, 4.0, 10.0, 1.99, Station((25.0, 25.0)))
PLACES = np.random.default_rng(5).uniform(0.0, 50.0, (500, 2))


@pytest.mark.parametrize(
    ("omega", "tolerance_db"), [(1.99, 2e-4), (0.1, 4e-4), (0.0, 0.02)], ids=str
)
def test_against_double(omega, tolerance_db):
    """Mean and deviation, down to no multipath at all."""
    channel = replace(CHANNEL, multipath_std_db=omega)
    data = simulated(replace(CHANNEL, multipath_std_db=max(omega, 0.05)), 1, 300, 50.0)
    posterior = condition(channel, data)
    expected, found = posterior.predict(PLACES), predict_single(posterior, PLACES)
    np.testing.assert_allclose(found.mean_db, expected.mean_db, atol=tolerance_db)
    np.testing.assert_allclose(found.deviation_db, expected.deviation_db, atol=tolerance_db)


def test_blocks_and_large_coordinates(monkeypatch):
    """Projected coordinates of 3e6 m keep their digits; so do places split into blocks."""
    monkeypatch.setattr("planopt.channel.maps.tile_map.PLACES_AT_ONCE", 64)
    far = np.array([500_000.0, 3_000_000.0])
    data = simulated(CHANNEL, 2, 150, 50.0)
    moved = Measurements(data.positions_m + far, data.power_dbm, data.censored)
    station = Station((25.0 + far[0], 25.0 + far[1]))
    expected = condition(CHANNEL, data).predict(PLACES)
    found = predict_single(condition(replace(CHANNEL, station=station), moved), PLACES + far)
    np.testing.assert_allclose(found.mean_db, expected.mean_db, atol=2e-4)
    np.testing.assert_allclose(found.deviation_db, expected.deviation_db, atol=2e-4)


def test_without_measurements():
    """The prior, weak theta included."""
    nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
    posterior = condition(CHANNEL, nothing)
    expected, found = posterior.predict(PLACES), predict_single(posterior, PLACES)
    np.testing.assert_allclose(found.mean_db, expected.mean_db, rtol=1e-12)
    np.testing.assert_allclose(found.deviation_db, expected.deviation_db, rtol=1e-12)


def test_bad_places():
    """Positions that cannot be used."""
    with pytest.raises(InputError):
        predict_single(condition(CHANNEL, simulated(CHANNEL, 1, 20, 50.0)), np.zeros(3))
