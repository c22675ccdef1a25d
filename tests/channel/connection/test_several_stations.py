"""Several stations against simulation, closed forms and each other."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm
from simulated_channel import simulated

from planopt.channel.connection.serving_power import (
    SharedShadowing,
    connected_to_any,
    strongest_station,
)
from planopt.channel.kriging import predict
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition
from planopt.errors import InputError

CHANNEL = ChannelParameters(-40.0, 2.5, 6.0, 30.0, 2.0, Station((0.0, 0.0), 10.0))
NOTHING = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
PLACES = np.random.default_rng(4).uniform(20.0, 180.0, (6, 2))
THRESHOLD = -92.0


def station(x, y, seed, **changes):
    """A station's posterior from 20 measurements."""
    channel = dataclasses.replace(CHANNEL, station=Station((x, y), 10.0), **changes)
    return condition(channel, simulated(channel, seed, 20, 200.0))


THREE = (
    station(0.0, 0.0, 1),
    station(200.0, 0.0, 2, shadow_std_db=3.0),
    station(100.0, 220.0, 3, multipath_std_db=1.0),
)


def shared(correlation, stations=3):
    """Equal correlation between all stations."""
    matrix = np.full((stations, stations), correlation)
    np.fill_diagonal(matrix, 1.0)
    return SharedShadowing(matrix, np.random.default_rng(0))


def drawn(correlation, count=200_000):
    """Powers of the three at the places, shadowing errors mixed from a common and an own part."""
    generator = np.random.default_rng(7)
    common = generator.standard_normal((count, len(PLACES)))
    powers = []
    for posterior in THREE:
        prediction = predict(posterior, PLACES)
        omega = posterior.parameters.multipath_std_db
        latent = np.sqrt(prediction.deviation_db**2 - omega**2)
        own, white = generator.standard_normal((2, count, len(PLACES)))
        shadowing = np.sqrt(correlation) * common + np.sqrt(1.0 - correlation) * own
        powers.append(prediction.mean_db + latent * shadowing + omega * white)
    return np.stack(powers)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_against_simulation(correlation):
    """Any connected, and the strongest, within 4 standard errors and the stated error."""
    powers = drawn(correlation)
    given = shared(correlation) if correlation else None
    found = connected_to_any(THREE, PLACES, THRESHOLD, given)
    frequency = (powers >= THRESHOLD).any(axis=0).mean(axis=0)
    slack = 4.0 * np.sqrt(0.25 / 200_000) + found.error
    assert (np.abs(found.probability - frequency) < slack).all()
    best = strongest_station(THREE, PLACES, given)
    for number in range(3):
        frequency = (powers.argmax(axis=0) == number).mean(axis=0)
        slack = 4.0 * np.sqrt(0.25 / 200_000) + best.error[number]
        assert (np.abs(best.probability[number] - frequency) < slack).all()


def test_independent_equals_correlation_zero():
    """Both ways to the same numbers."""
    alone = connected_to_any(THREE, PLACES, THRESHOLD)
    zero = connected_to_any(THREE, PLACES, THRESHOLD, shared(0.0))
    np.testing.assert_allclose(alone.probability, zero.probability, atol=1e-9)
    alone, zero = strongest_station(THREE, PLACES), strongest_station(THREE, PLACES, shared(0.0))
    assert (np.abs(alone.probability - zero.probability) <= 2.0 * zero.error + 1e-9).all()
    assert (alone.error == 0.0).all()


def test_two_stations_in_closed_form():
    """P(first is stronger) = Phi((mu_1 - mu_2) / sqrt(s_1^2 + s_2^2))."""
    one, two = (predict(posterior, PLACES) for posterior in THREE[:2])
    expected = norm.cdf((one.mean_db - two.mean_db) / np.hypot(one.deviation_db, two.deviation_db))
    found = strongest_station(THREE[:2], PLACES)
    np.testing.assert_allclose(found.probability, [expected, 1.0 - expected], atol=1e-12)
    correlated = strongest_station(THREE[:2], PLACES, shared(0.5, 2))
    latent = np.sqrt(np.array([one.deviation_db**2 - 4.0, two.deviation_db**2 - 4.0]))
    spread = np.sqrt(one.deviation_db**2 + two.deviation_db**2 - latent.prod(axis=0))
    expected = norm.cdf((one.mean_db - two.mean_db) / spread)
    np.testing.assert_allclose(correlated.probability[0], expected, atol=1e-12)


def test_sharing_costs_diversity():
    """The more shadowing is shared, the less several stations help; one station bounds it."""
    values = [
        connected_to_any(THREE, PLACES, THRESHOLD, shared(correlation)).probability
        for correlation in (0.0, 0.4, 0.8)
    ]
    assert (np.diff(values, axis=0) <= 3e-4).all()
    alone = np.max([posterior.connectivity(PLACES, THRESHOLD) for posterior in THREE], axis=0)
    assert (values[-1] >= alone - 3e-4).all()


def test_sums_to_one():
    """One station is the strongest."""
    assert strongest_station(THREE, PLACES).probability.sum(axis=0) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("given", [None, shared(0.0, 1)])
def test_one_station(given):
    """Its own connectivity, and always the strongest."""
    found = connected_to_any(THREE[:1], PLACES, THRESHOLD, given)
    np.testing.assert_allclose(found.probability, THREE[0].connectivity(PLACES, THRESHOLD))
    np.testing.assert_allclose(strongest_station(THREE[:1], PLACES, given).probability, 1.0)


def test_known_powers():
    """Without randomness the nearer station is the strongest; equals share."""
    flat = dataclasses.replace(CHANNEL, shadow_std_db=0.0, multipath_std_db=0.0)
    twins = [condition(flat, NOTHING, theta="known")] * 2
    np.testing.assert_allclose(strongest_station(twins, PLACES).probability, 0.5)
    far = dataclasses.replace(flat, station=Station((500.0, 500.0)))
    pair = [twins[0], condition(far, NOTHING, theta="known")]
    np.testing.assert_allclose(
        strongest_station(pair, PLACES).probability, [np.ones(6), np.zeros(6)], atol=1e-12
    )


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(2),
        np.full((3, 3), np.nan),
        np.array([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        2.0 * np.eye(3),
        np.array([[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]]),
    ],
)
def test_no_correlation_matrix(matrix):
    """Shape, numbers, symmetry, diagonal and definiteness are checked."""
    with pytest.raises(InputError, match=r"shared\.correlation"):
        connected_to_any(
            THREE, PLACES, THRESHOLD, SharedShadowing(matrix, np.random.default_rng(0))
        )


def test_nothing_given():
    """No station, no place, no threshold."""
    with pytest.raises(InputError, match="no station"):
        strongest_station([], PLACES)
    with pytest.raises(InputError, match="positions_m"):
        connected_to_any(THREE, np.zeros((0, 2)), THRESHOLD)
    with pytest.raises(InputError, match="threshold_dbm"):
        connected_to_any(THREE, PLACES, np.nan)
