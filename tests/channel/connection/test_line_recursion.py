"""The recursion along a line against the multivariate normal distribution and closed forms."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from planopt.channel.connection.first_passage import line_prefix_probabilities
from planopt.channel.connection.joint_connectivity import prefix_probabilities
from planopt.channel.joint import joint_prediction
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition
from planopt.errors import InputError

CHANNEL = ChannelParameters(-30.0, 3.0, 4.0, 20.0, 1.13, Station((0.0, 0.0)))
LINE = np.array([40.0, 10.0]) + np.array([1.0, 3.0, 3.5, 8.0, 20.0, 21.0])[:, None] * [0.6, 0.8]
NOTHING = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
THRESHOLD = -80.0


def prior(channel, path):
    """Mean and covariance before any measurement."""
    return joint_prediction(condition(channel, NOTHING, theta="known"), path)


@pytest.mark.parametrize(("event", "sign"), [("connected", 1.0), ("disconnected", -1.0)])
@pytest.mark.parametrize(("shadow", "omega", "beta"), [(4.0, 1.13, 20.0), (3.2, 3.02, 3.09)])
def test_equals_the_multivariate_normal(event, sign, shadow, omega, beta):
    """Every prefix, uneven legs and falling mean, for both events."""
    channel = dataclasses.replace(
        CHANNEL, shadow_std_db=shadow, multipath_std_db=omega, decorrelation_m=beta
    )
    found = line_prefix_probabilities(channel, LINE, THRESHOLD, event)
    prediction = prior(channel, LINE)
    above = sign * (prediction.mean_db - THRESHOLD)
    expected = prefix_probabilities(
        above, prediction.covariance_db2, np.random.default_rng(0), 1e-5
    )
    assert (np.abs(found - expected.probability) <= 2.0 * expected.error + 1e-9).all()
    pair = multivariate_normal.cdf(above[:2], cov=prediction.covariance_db2[:2, :2])
    assert found[0] == pytest.approx(norm.cdf(above[0] / np.hypot(shadow, omega)), abs=1e-12)
    assert found[1] == pytest.approx(pair, abs=1e-10)


@pytest.mark.parametrize(("channel", "exact"), [((3.2, 3.02, 3.09), 0.461), ((4, 1.13, 20), 0.773)])
def test_checked_values_of_the_theory(channel, exact):
    """Equation 3.9: 20 places 1 m apart at 0.95; a flat mean by an exponent of zero."""
    shadow, omega, beta = channel
    level = norm.ppf(0.95) * np.hypot(shadow, omega)
    flat = ChannelParameters(level, 0.0, shadow, beta, omega, Station((0.0, 0.0)))
    path = np.column_stack([np.arange(20.0), np.zeros(20)])
    found = line_prefix_probabilities(flat, path, 0.0, "connected")
    assert found[-1] == pytest.approx(exact, abs=5e-4)


def test_repeated_place():
    """Standing still: shadowing is kept and multipath drawn again."""
    twice = LINE[[0, 0]]
    found = line_prefix_probabilities(CHANNEL, twice, THRESHOLD, "connected")
    prediction = prior(CHANNEL, twice)
    expected = multivariate_normal.cdf(
        prediction.mean_db - THRESHOLD, cov=prediction.covariance_db2
    )
    assert found[1] == pytest.approx(expected, abs=1e-9)


def test_no_shadowing():
    """Independent places: products."""
    channel = dataclasses.replace(CHANNEL, shadow_std_db=0.0)
    found = line_prefix_probabilities(channel, LINE, THRESHOLD, "connected")
    alone = norm.cdf((prior(channel, LINE).mean_db - THRESHOLD) / 1.13)
    np.testing.assert_allclose(found, np.cumprod(alone), rtol=1e-12)


@pytest.mark.parametrize("path", [LINE[[0, 2, 1]], np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])])
def test_not_straight(path):
    """Turning back and turning aside are refused."""
    with pytest.raises(InputError, match="not straight"):
        line_prefix_probabilities(CHANNEL, path, THRESHOLD, "connected")


@pytest.mark.parametrize("omega", [0.0, 1e-3])
def test_too_narrow(omega):
    """No multipath, or hardly any: the integral would be too fine."""
    channel = dataclasses.replace(CHANNEL, multipath_std_db=omega)
    with pytest.raises(InputError, match="too small"):
        line_prefix_probabilities(channel, LINE, THRESHOLD, "connected")
