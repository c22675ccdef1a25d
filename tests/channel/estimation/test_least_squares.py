"""The least-squares line, with and without censoring."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.estimation.least_squares import coefficient_covariance, least_squares
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.parameters import mean_model

CHANNEL = ChannelParameters(-40.0, 3.0, 1e-3, 1.0, 4.0, Station((50.0, 50.0), 10.0))


def model_of(measurements, station=CHANNEL.station):
    """The full mean model."""
    return mean_model(measurements.positions_m, ~measurements.censored, station, True)


def test_is_lemma_1_without_censoring():
    """theta-hat and alpha-hat equal NumPy's least squares, alpha divided by n."""
    measurements = simulated(CHANNEL, 0, 60, 200.0)
    model = model_of(measurements)
    found = least_squares(model, measurements)
    theta, squares, *_ = np.linalg.lstsq(model.columns, measurements.power_dbm, rcond=None)
    np.testing.assert_allclose(found.coefficients, theta, rtol=1e-9)
    assert found.variance_db2 == pytest.approx(squares[0] / 60)
    np.testing.assert_allclose(model.columns.T @ found.residual_db, 0.0, atol=1e-8)


def test_is_the_tobit_maximum_likelihood_with_censoring():
    """The fixed point of EM maximises the censored likelihood with independent deviations."""
    measurements = simulated(CHANNEL, 1, 150, 200.0, 0.3)
    model = model_of(measurements)
    found = least_squares(model, measurements)

    def loss(x):
        z = (measurements.power_dbm - model.columns @ x[:2]) / np.exp(x[2])
        each = np.where(measurements.censored, norm.logcdf(z), norm.logpdf(z) - x[2])
        return -each.sum()

    best = minimize(loss, [-40.0, 3.0, 1.0], method="Nelder-Mead", options={"xatol": 1e-8})
    np.testing.assert_allclose(found.coefficients, best.x[:2], rtol=2e-3)
    assert found.variance_db2 == pytest.approx(np.exp(2 * best.x[2]), rel=1e-3)


def test_rounding_is_taken_out_of_the_variance():
    """alpha-hat of powers rounded to 6 dB is that of the powers, not r^2 / 12 = 3 dB^2 more."""
    measurements = simulated(CHANNEL, 3, 1500, 200.0)
    power = np.round(measurements.power_dbm / 6.0) * 6.0
    plain = dataclasses.replace(measurements, power_dbm=power)
    rounded = dataclasses.replace(plain, resolution_db=np.full(1500, 6.0))
    exact, raw, found = (
        least_squares(model_of(each), each) for each in (measurements, plain, rounded)
    )
    assert raw.variance_db2 - found.variance_db2 == pytest.approx(3.0)
    assert found.variance_db2 == pytest.approx(exact.variance_db2, abs=0.5)
    np.testing.assert_array_equal(found.coefficients, raw.coefficients)


def test_coefficient_covariance_is_the_sandwich():
    """The blockwise covariance equals the dense formula under correlated shadowing."""
    channel = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0)))
    measurements = simulated(channel, 2, 700, 200.0)
    model = model_of(measurements, channel.station)
    positions = measurements.positions_m
    outer = np.linalg.pinv(model.columns)
    for step in (0.0, 6.0):
        given = dataclasses.replace(measurements, resolution_db=np.full(700, step))
        dense = shadow_covariance_db2(positions, positions, channel)
        dense += (4.0 + step**2 / 12.0) * np.eye(700)
        np.testing.assert_allclose(
            coefficient_covariance(model, given, channel),
            outer @ dense @ outer.T,
            rtol=1e-6,
        )


def test_covariance_where_offsets_hide_the_slope():
    """It is positive semidefinite, and no rounding of a place moves it, though ill conditioned.

    Two receivers, neither the reference: at equal distances one of them, slightly farther the
    other, so that the slope shows in the ridge on their offsets alone.
    """
    rng = np.random.default_rng(5)
    station = Station((0.0, 0.0), 5.0)
    places = 35.65 * np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 1.0]])
    parameters = dataclasses.replace(CHANNEL, station=station, shadow_std_db=6.0)
    found = []
    for _ in range(40):
        measurements = Measurements(
            places * (1.0 + 1e-15 * rng.standard_normal(places.shape)),
            np.full(3, -70.0),
            np.zeros(3, dtype=bool),
            receiver=np.array([2, 2, 1]),
        )
        covariance = coefficient_covariance(
            model_of(measurements, station), measurements, parameters
        )
        assert np.linalg.eigvalsh(covariance)[0] >= 0.0
        found.append(covariance)
    np.testing.assert_allclose(found, np.broadcast_to(found[0], (40, 2, 2)), rtol=1e-6)
