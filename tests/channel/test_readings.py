"""What measurements would read, against the posterior at places, other times and receivers."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel import (
    ChannelParameters,
    Station,
    at_time,
    condition,
    marginalise,
    predict_readings,
)
from planopt.channel.kriging import predict

CHANNEL = ChannelParameters(-30.0, 2.8, 6.0, 30.0, 2.0, Station((20.0, 35.0), 3.0))
KNOWN = simulated(CHANNEL, 3, 60, 200.0)
MORE = simulated(CHANNEL, 4, 25, 200.0)


def assert_same(one, other):
    np.testing.assert_allclose(one.mean_db, other.mean_db, rtol=1e-10)
    np.testing.assert_allclose(one.deviation_db, other.deviation_db, rtol=1e-10)


@pytest.mark.parametrize("learn", [condition, marginalise])
def test_plain_readings_are_predictions_at_places(learn):
    """Without anything else it is the posterior at their positions, powers unseen."""
    posterior = learn(CHANNEL, KNOWN)
    unseen = replace(MORE, power_dbm=MORE.power_dbm + 50.0)
    assert_same(predict_readings(posterior, unseen), posterior.predict(MORE.positions_m))


def test_rounding_adds_its_variance():
    """A step of r adds r^2 / 12."""
    posterior = condition(CHANNEL, KNOWN)
    rounded = replace(MORE, resolution_db=np.full(len(MORE), 3.0))
    found, plain = predict_readings(posterior, rounded), posterior.predict(MORE.positions_m)
    np.testing.assert_allclose(found.deviation_db**2 - plain.deviation_db**2, 0.75, rtol=1e-9)


def test_position_errors():
    """As the posterior predicts for a robot that is not sure of its place, with the fit's n_PL."""
    posterior = condition(CHANNEL, KNOWN, theta="known")
    std_m = np.linspace(0.0, 8.0, len(MORE))
    found = predict_readings(posterior, replace(MORE, position_std_m=std_m))
    assert_same(found, predict(posterior, MORE.positions_m, std_m))


def test_each_reading_has_its_own_time():
    """In a channel that forgets each is predicted for when it is taken."""
    drifting = replace(CHANNEL, forgetting_s=100.0)
    posterior = condition(drifting, replace(KNOWN, time_s=np.arange(60.0)))
    time_s = np.linspace(60.0, 400.0, len(MORE))
    found = predict_readings(posterior, replace(MORE, time_s=time_s))
    alone = [
        at_time(posterior, now_s).predict(MORE.positions_m[index][None])
        for index, now_s in enumerate(time_s)
    ]
    np.testing.assert_allclose(found.mean_db, [one.mean_db[0] for one in alone], rtol=1e-10)
    np.testing.assert_allclose(
        found.deviation_db, [one.deviation_db[0] for one in alone], rtol=1e-10
    )


def test_readings_of_another_receiver_have_its_offset():
    """A receiver that read 9 dB more will do so again."""
    other = np.arange(60) % 2
    known = replace(KNOWN, power_dbm=KNOWN.power_dbm + 9.0 * other, receiver=other)
    posterior = condition(CHANNEL, known)
    first, second = (
        predict_readings(posterior, replace(MORE, receiver=np.full(len(MORE), number)))
        for number in (0, 1)
    )
    np.testing.assert_allclose(second.mean_db - first.mean_db, 9.0, atol=1.5)
    assert (second.deviation_db > 0.9 * first.deviation_db).all()
