"""The predictors that the channel is compared with: a plain line and a plain Gaussian process."""

import dataclasses

import numpy as np
import pytest
from simulated_channel import simulated, subset

from planopt import InputError
from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.held_out import learn_plain_line, learn_plain_process

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 40.0, 2.0, Station((50.0, 50.0), 10.0))
FLAT = dataclasses.replace(CHANNEL, n_pl=0.0)


def test_line_is_a_polynomial_of_degree_one_in_the_logarithm():
    """NumPy's, of the uncensored powers alone, with the deviation of its residuals."""
    measurements = simulated(CHANNEL, 0, 80, 200.0, 0.3)
    exact = measurements.take(np.flatnonzero(~measurements.censored))
    found = learn_plain_line(measurements, CHANNEL.station)(measurements)
    distance = [
        np.hypot(np.linalg.norm(m.positions_m - CHANNEL.station.position_m, axis=1), 10.0)
        for m in (exact, measurements)
    ]
    line, covariance = np.polyfit(np.log10(distance[0]), exact.power_dbm, 1, cov=True)
    np.testing.assert_allclose(found.mean_db, np.polyval(line, np.log10(distance[1])), rtol=1e-9)
    centred = np.log10(distance[0]) - np.log10(distance[0]).mean()
    np.testing.assert_allclose(found.deviation_db**2, covariance[0, 0] * centred @ centred)


def test_line_at_one_distance_is_the_mean():
    """Where no slope can be told, the powers there are predicted by their mean."""
    angle = np.linspace(0.0, 6.0, 12)
    places = CHANNEL.station.position_m + 30.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    powers = -70.0 + np.arange(12.0)
    around = Measurements(places, powers, np.zeros(12, dtype=bool))
    found = learn_plain_line(around, CHANNEL.station)(around)
    np.testing.assert_allclose(found.mean_db, powers.mean())


def test_process_predicts_what_it_should():
    """Without path loss it is nearly as good as the true covariance, and as sure as it may be."""
    both = simulated(FLAT, 5, 700, 200.0)
    known, asked = both.take(slice(400)), both.take(slice(400, None))
    found = learn_plain_process(known)(asked)
    true = CHANNEL.shadow_std_db**2 * np.exp(
        -np.linalg.norm(both.positions_m[:, None] - both.positions_m, axis=2)
        / CHANNEL.decorrelation_m
    )
    own = true[:400, :400] + CHANNEL.multipath_std_db**2 * np.eye(400)
    mean = known.power_dbm.mean()
    oracle = mean + true[400:, :400] @ np.linalg.solve(own, known.power_dbm - mean)
    rmse = [np.sqrt(np.mean((asked.power_dbm - one) ** 2)) for one in (found.mean_db, oracle)]
    assert rmse[0] < 1.05 * rmse[1] < 0.7 * asked.power_dbm.std()
    inside = np.abs(asked.power_dbm - found.mean_db) < 1.96 * found.deviation_db
    assert 0.9 < inside.mean() < 0.99


def test_process_does_not_depend_on_the_order_of_rows(monkeypatch):
    """Not even where it rests on a draw of them; and upper limits play no part."""
    monkeypatch.setattr("planopt.channel.held_out.MOST_LIKELIHOOD", 50)
    monkeypatch.setattr("planopt.channel.held_out.MOST_CONDITIONED", 80)
    measurements = simulated(CHANNEL, 7, 120, 200.0, 0.1)
    shuffled = subset(measurements, np.random.default_rng(1).permutation(120))
    exact = measurements.take(np.flatnonzero(~measurements.censored))
    first, *others = (
        learn_plain_process(one)(exact).mean_db for one in (measurements, shuffled, exact)
    )
    for other in others:
        np.testing.assert_array_equal(other, first)


def test_upper_limits_alone_are_refused():
    """There is nothing to learn."""
    limits = dataclasses.replace(simulated(CHANNEL, 2, 9, 90.0), censored=np.ones(9, dtype=bool))
    for learn in (learn_plain_process, lambda m: learn_plain_line(m, CHANNEL.station)):
        with pytest.raises(InputError):
            learn(limits)
