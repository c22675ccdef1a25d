"""First connection: the recursion on a line, simulation, independence, conditioning."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm
from simulated_channel import simulated

from planopt import InputError
from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    condition,
    first_passage,
    sample_power,
)
from planopt.channel.parameters import regressors

CHANNEL = ChannelParameters(-30.0, 3.0, 5.0, 15.0, 1.5, Station((0.0, 0.0)))
NOTHING = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
PRIOR = condition(CHANNEL, NOTHING, theta="known")
LINE = np.column_stack([np.full(12, 30.0), 40.0 - np.linspace(0.0, 30.0, 12) ** 1.05])
CURVE = np.column_stack([np.linspace(60.0, 30.0, 9), 50.0 + 10.0 * np.cos(np.arange(9.0))])
THRESHOLD = -76.0


def missed_on_a_line(path, disconnected_now):
    """pi_k before any measurement by the recursion of equation 3.9, on a grid of shadowing."""
    places = path if disconnected_now else path[1:]
    grid, step = np.linspace(-45.0, 45.0, 1801, retstep=True)
    mean = regressors(places, CHANNEL.station) @ [CHANNEL.k_pl_db, CHANNEL.n_pl]
    misses = norm.cdf((THRESHOLD - mean[:, None] - grid) / CHANNEL.multipath_std_db)
    mass = norm.pdf(grid, 0.0, CHANNEL.shadow_std_db) * misses[0]
    found = [step * mass.sum()]
    for leg, miss in zip(np.hypot(*np.diff(places, axis=0).T), misses[1:], strict=True):
        rho = np.exp(-leg / CHANNEL.decorrelation_m)
        spread = CHANNEL.shadow_std_db * np.sqrt(1.0 - rho**2)
        mass = step * (norm.pdf(grid[:, None], rho * grid, spread) @ mass) * miss
        found.append(step * mass.sum())
    return np.array(found) / found[0] if disconnected_now else np.append(1.0, found)


@pytest.mark.parametrize("disconnected_now", [False, True])
def test_prior_on_a_line(disconnected_now):
    """The multivariate normal integral equals the recursion within its stated error."""
    found = first_passage(
        PRIOR, LINE, THRESHOLD, np.random.default_rng(0), disconnected_now=disconnected_now
    )
    line = missed_on_a_line(LINE, disconnected_now)
    off = np.abs(found.not_connected - line)
    assert (off <= 2.0 * found.not_connected_error + 1e-6).all()
    np.testing.assert_allclose(found.travelled_m[-1], 40.0 - LINE[-1, 1])
    # Taking places as independent promises too much (equation 3.10).
    missed = 1.0 - PRIOR.connectivity(LINE[1:], THRESHOLD)
    assert np.prod(missed) < 0.5 * found.not_connected[-1]


@pytest.mark.parametrize("disconnected_now", [False, True])
def test_posterior_on_a_curve_by_simulation(disconnected_now):
    """Distribution and expected distance against driving through sampled fields."""
    posterior = condition(CHANNEL, simulated(CHANNEL, 1, 15, 70.0))
    found = first_passage(
        posterior, CURVE, THRESHOLD, np.random.default_rng(0), disconnected_now=disconnected_now
    )
    power = sample_power(posterior, CURVE, 60_000, np.random.default_rng(2))
    connected = power >= THRESHOLD
    if disconnected_now:
        connected = connected[~connected[:, 0]]
    count = len(connected)
    legs = np.hypot(*np.diff(CURVE, axis=0).T)
    driven = np.zeros(count)
    searching = np.ones(count, dtype=bool)
    for leg, now, expected in zip(legs, connected[:, 1:].T, found.not_connected[1:], strict=True):
        driven += leg * searching
        searching &= ~now
        error = np.sqrt(expected * (1.0 - expected) / count)
        assert abs(searching.mean() - expected) < 4.0 * error + 2e-4
    assert abs(driven.mean() - found.expected_distance_m) < 4.0 * driven.std() / np.sqrt(count)


def test_independent_places():
    """Without shadowing pi_k is the product of the single misses."""
    channel = dataclasses.replace(CHANNEL, shadow_std_db=0.0, multipath_std_db=6.0)
    posterior = condition(channel, NOTHING, theta="known")
    found = first_passage(posterior, CURVE, THRESHOLD, np.random.default_rng(0))
    missed = 1.0 - posterior.connectivity(CURVE[1:], THRESHOLD)
    np.testing.assert_allclose(found.not_connected, np.cumprod([1.0, *missed]), rtol=1e-9)
    np.testing.assert_allclose(found.connected_by, 1.0 - found.not_connected)


def test_being_disconnected_is_bad_news():
    """Given no connection now, the expected distance is longer than without knowing."""
    generator = np.random.default_rng(0)
    unknown, out = (
        first_passage(PRIOR, LINE, THRESHOLD, generator, disconnected_now=known)
        for known in (False, True)
    )
    assert out.expected_distance_m > 1.05 * unknown.expected_distance_m
    assert out.not_connected[0] == 1.0


def test_two_places():
    """One leg is always driven; the end is connected with its own probability."""
    found = first_passage(PRIOR, CURVE[:2], THRESHOLD, np.random.default_rng(0))
    assert found.expected_distance_m == pytest.approx(np.hypot(*(CURVE[1] - CURVE[0])))
    assert found.connected_by[1] == pytest.approx(PRIOR.connectivity(CURVE[1:2], THRESHOLD)[0])


def test_impossible_condition():
    """A place that is surely connected cannot be given as not."""
    with pytest.raises(InputError, match="disconnected_now"):
        first_passage(PRIOR, CURVE, -1000.0, np.random.default_rng(0), disconnected_now=True)


def test_one_place_is_no_path():
    """At least a leg is needed."""
    with pytest.raises(InputError, match="at least 2"):
        first_passage(PRIOR, CURVE[:1], THRESHOLD, np.random.default_rng(0))
