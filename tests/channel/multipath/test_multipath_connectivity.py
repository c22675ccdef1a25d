"""Connectivity under exact multipath against quadrature, closed forms and simulation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from multipath_law import law_of
from scipy.integrate import quad
from scipy.stats import norm
from simulated_channel import simulated

from planopt.channel.kriging import predict
from planopt.channel.multipath.multipath_connectivity import (
    multipath_connection_probability,
    multipath_connectivity,
)
from planopt.channel.multipath.multipath_models import (
    Lognormal,
    Nakagami,
    Rician,
    multipath_survival,
    rician_field_db,
)
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition
from planopt.channel.prediction import connection_probability
from planopt.errors import InputError


@pytest.mark.parametrize("model", [Nakagami(0.5), Nakagami(15.75), Rician(0.0), Rician(30.0)])
@pytest.mark.parametrize("latent", [0.05, 2.0, 9.0])
def test_against_adaptive_quadrature(model, latent):
    """Equation 3.3 by SciPy's quadrature, to 1e-9."""
    law, offset = law_of(model)
    mean = np.array([-90.0, -84.0, -80.0])
    found = multipath_connection_probability(mean, np.full(3, latent), -83.0, model)

    def integrand(score, at):
        return norm.pdf(score) * law.sf(10.0 ** ((-83.0 - at - latent * score + offset) / 10.0))

    for value, at in zip(found, mean, strict=True):
        edge = np.clip((-83.0 - at) / latent, -8.0, 8.0)
        expected = quad(integrand, -9.0, 9.0, args=(at,), points=[edge], epsabs=1e-11, limit=200)
        assert value == pytest.approx(expected[0], abs=1e-9)


@pytest.mark.parametrize("k_factor", [0.0, 10.0])
def test_against_simulation(k_factor):
    """Gaussian shadowing plus fading drawn as complex amplitudes, within 4 standard errors."""
    count, generator = 400_000, np.random.default_rng(0)
    for mean, latent in ((-82.0, 3.0), (-86.0, 6.0)):
        power = mean + latent * generator.standard_normal(count)
        power += rician_field_db((count,), k_factor, generator)
        found = multipath_connection_probability(
            np.array([mean]), np.array([latent]), -83.0, Rician(k_factor)
        )[0]
        error = np.sqrt(found * (1.0 - found) / count)
        assert abs((power >= -83.0).mean() - found) < 4.0 * error


def test_lognormal_is_the_ordinary_connectivity():
    """Closed form, with either part or both absent too."""
    mean, latent = np.array([-90.0, -83.0, -80.0, -83.5]), np.array([4.0, 0.0, 2.0, 0.0])
    for omega in (0.0, 2.0):
        found = multipath_connection_probability(mean, latent, -83.0, Lognormal(omega))
        expected = connection_probability(mean, np.hypot(latent, omega), -83.0)
        np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("model", [Nakagami(3.27), Rician(5.0)])
def test_no_shadowing_left(model):
    """Latent deviation zero: the fading's own distribution."""
    mean = np.linspace(-95.0, -70.0, 9)
    found = multipath_connection_probability(mean, np.zeros(9), -83.0, model)
    np.testing.assert_allclose(found, multipath_survival(model, -83.0 - mean), atol=1e-14)


def test_weak_fading_tends_to_lognormal():
    """At large m the law in dB is nearly Gaussian."""
    mean, latent = np.linspace(-95.0, -70.0, 9), np.full(9, 3.0)
    for model in (Nakagami(300.0), Rician(300.0)):
        found = multipath_connection_probability(mean, latent, -83.0, model)
        near = multipath_connection_probability(mean, latent, -83.0, Lognormal(model.std_db))
        np.testing.assert_allclose(found, near, atol=2e-4)


@settings(deadline=None, max_examples=60)
@given(st.floats(0.0, 12.0), st.floats(0.5, 60.0), st.floats(-150.0, 50.0))
def test_probability_rises_with_the_mean(latent, m, mean):
    """Between zero and one, and increasing."""
    steps = mean + np.array([0.0, 0.5, 1.0])
    found = multipath_connection_probability(steps, np.full(3, latent), -83.0, Nakagami(m))
    assert (found >= 0.0).all()
    assert (found <= 1.0).all()
    assert (np.diff(found) >= -1e-13).all()


def test_from_a_posterior():
    """The latent deviation is the prediction's without omega; blocks do not show."""
    channel = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))
    posterior = condition(channel, simulated(channel, 0, 40, 200.0))
    places = np.random.default_rng(1).uniform(0.0, 200.0, (8_000, 2))
    prediction = predict(posterior, places)
    found = multipath_connectivity(posterior, places, -95.0, Lognormal(2.0))
    np.testing.assert_allclose(
        found, connection_probability(prediction.mean_db, prediction.deviation_db, -95.0), atol=1e-9
    )
    exact = multipath_connectivity(posterior, places, -95.0, Rician(10.0))
    again = multipath_connectivity(posterior, places[-5:], -95.0, Rician(10.0))
    np.testing.assert_allclose(exact[-5:], again, atol=1e-12)
    assert 0.0 < np.abs(exact - found).max() < 0.02


@pytest.mark.parametrize(
    ("mean", "latent", "threshold"),
    [
        (np.zeros(2), np.zeros(3), 0.0),
        (np.zeros((1, 1)), np.zeros((1, 1)), 0.0),
        (np.array([np.nan]), np.ones(1), 0.0),
        (np.zeros(1), np.array([-1.0]), 0.0),
        (np.zeros(1), np.ones(1), np.inf),
    ],
)
def test_bad_input(mean, latent, threshold):
    """Shapes, signs and numbers that cannot be used."""
    with pytest.raises(InputError):
        multipath_connection_probability(mean, latent, threshold, Nakagami(2.0))
