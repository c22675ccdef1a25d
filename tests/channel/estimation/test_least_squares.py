"""The least-squares line, with and without censoring."""

import dataclasses

import numpy as np
import pytest
from refusals import refused
from scipy.optimize import minimize
from scipy.stats import norm
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.estimation.least_squares import coefficient_covariance, examine, least_squares
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import mean_model

CHANNEL = ChannelParameters(-40.0, 3.0, 1e-3, 1.0, 4.0, Station((50.0, 50.0), 10.0))


def model_of(measurements, station=CHANNEL.station):
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
            coefficient_covariance(model, given, channel), outer @ dense @ outer.T, rtol=1e-6
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


ORIGIN = Station((0.0, 0.0))


def at(positions, censored=None):
    positions = np.asarray(positions, dtype=float).reshape(-1, 2)
    count = len(positions)
    flags = np.zeros(count, bool) if censored is None else np.asarray(censored)
    return Measurements(positions, np.full(count, -70.0), flags)


def test_a_measurement_at_the_station_is_named():
    """The error carries the index of the measurement; a height makes it usable."""
    measurements = at([[1, 0], [2, 0], [0, 0], [5, 5]])
    with refused() as caught:
        examine(measurements, ORIGIN)
    assert caught.value.row == 2
    examine(measurements, Station((0.0, 0.0), 3.0))


def test_what_measurements_identify():
    """One distance hides n_PL; few or crowded exact values hide the covariance; beta has bounds."""
    angle = np.linspace(0, 6, 20)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1) * 30.0
    found = examine(at(circle), ORIGIN)
    assert "one distance" in (found.n_pl_reason or "")
    assert found.covariance_reason is None
    assert examine(at(circle + np.array([5.0, 0.0])), ORIGIN).n_pl_reason is None
    line = np.arange(1, 21)[:, None] * np.array([[1.0, 0.0]])
    assert examine(at(line), ORIGIN).covariance_reason is None
    few = examine(at(line, np.arange(20) > 4), ORIGIN)
    assert "5 uncensored" in (few.covariance_reason or "")
    crowded = examine(at([[1, 0]] * 5 + [[2, 0]] * 5), ORIGIN)
    assert "three places" in (crowded.covariance_reason or "")
    lattice = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2) * 6.0
    for offset in (1.0, 3e6):
        found = examine(at(np.repeat(lattice, 2, axis=0) + offset), ORIGIN)
        assert found.decorrelation_bounds_m == pytest.approx((2.0, np.hypot(24.0, 18.0)))
