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
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import Lasting, regressors

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


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_multipath_that_lasts_is_common_at_close_times(share):
    """Against one dense normal distribution of all powers; also for readings taken one by one."""
    known = simulated(CHANNEL, 5, 40, 150.0, share)
    known = replace(known, time_s=np.arange(40.0))
    lasting = replace(CHANNEL, lasting=Lasting(0.7, 5.0))
    posterior = condition(lasting, known, theta="known")
    more = replace(MORE, time_s=np.linspace(0.0, 39.0, len(MORE)))
    found = predict_readings(posterior, more)
    times = np.concatenate([known.time_s, more.time_s])
    places = np.vstack([known.positions_m, more.positions_m])
    variance = CHANNEL.multipath_std_db**2
    total = shadow_covariance_db2(places, places, CHANNEL)
    total += 0.7 * variance * np.exp(-np.abs(times[:, None] - times) / 5.0)
    noise = np.concatenate([posterior.noise_variance_db2, np.full(len(more), 0.3 * variance)])
    total += np.diag(noise)
    mean = regressors(places, CHANNEL.station) @ [CHANNEL.k_pl_db, CHANNEL.n_pl]
    gain = np.linalg.solve(total[:40, :40], total[:40, 40:]).T
    expected = mean[40:] + gain @ (posterior.values_db - mean[:40])
    spread = np.diag(total)[40:] - np.einsum("ij,ij->i", gain, total[40:, :40])
    np.testing.assert_allclose(found.mean_db, expected, rtol=1e-9)
    np.testing.assert_allclose(found.deviation_db, np.sqrt(spread), rtol=1e-9)
    late = predict_readings(posterior, replace(more, time_s=np.full(len(more), 1e4)))
    assert_same(late, posterior.predict(more.positions_m))


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
