"""The likelihood of the station's position under a known covariance."""

import dataclasses
import math

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.estimation.station_fit import (
    gauss_newton,
    gaussian_covariance_db2,
    losses,
    station_surface,
)
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.parameters import regressors

CHANNEL = ChannelParameters(-40.0, 3.0, 4.0, 25.0, 1.5, Station((130.0, 70.0), 10.0))
MEASUREMENTS = simulated(CHANNEL, 1, 50, 200.0)
PLACES = np.array([[120.0, 80.0], [150.0, 40.0], [100.0, 60.0]])


def by_hand(place, prior):
    """Profiled loss and theta by generalised least squares with dense algebra."""
    positions = MEASUREMENTS.positions_m
    covariance = shadow_covariance_db2(positions, positions, CHANNEL) + 1.5**2 * np.eye(50)
    weights = np.linalg.inv(covariance)
    gamma = regressors(positions, Station(tuple(place), 10.0))
    precision = np.diag([0.0, 1.0]) if prior else np.zeros((2, 2))
    right = gamma.T @ weights @ MEASUREMENTS.power_dbm + precision @ [0.0, 3.0]
    theta = np.linalg.solve(gamma.T @ weights @ gamma + precision, right)
    residual = MEASUREMENTS.power_dbm - gamma @ theta
    surprise = theta - [0.0, 3.0]
    return 0.5 * (residual @ weights @ residual + surprise @ precision @ surprise), theta


@pytest.mark.parametrize("prior", [False, True])
def test_losses_are_those_of_generalised_least_squares(prior):
    """Value and theta at several places, with n_PL's prior of 3 +- 1 and without."""
    found = losses(station_surface(MEASUREMENTS, CHANNEL, has_prior=prior), PLACES)
    for place, loss, theta in zip(PLACES, found.loss, found.theta, strict=True):
        expected_loss, expected_theta = by_hand(place, prior)
        assert loss == pytest.approx(expected_loss, rel=1e-10)
        np.testing.assert_allclose(theta, expected_theta, rtol=1e-9)


@pytest.mark.parametrize("prior", [False, True])
@pytest.mark.parametrize("censored_share", [0.0, 0.2])
def test_gradient_is_that_of_the_losses(prior, censored_share):
    """Against central differences of the profiled loss."""
    measurements = simulated(CHANNEL, 2, 60, 200.0, censored_share)
    surface = station_surface(measurements, CHANNEL, has_prior=prior)
    step = 1e-3 * np.eye(2)
    for place in PLACES:
        _, gradient, _ = gauss_newton(surface, place)
        rise = losses(surface, place + step).loss - losses(surface, place - step).loss
        np.testing.assert_allclose(gradient, rise / 2e-3, rtol=1e-5, atol=1e-7)


def test_curvature_is_the_information_with_theta_unknown():
    """Without residuals the Gauss-Newton curvature is the Hessian of the profiled loss."""
    power = regressors(MEASUREMENTS.positions_m, CHANNEL.station) @ [-40.0, 3.0]
    surface = station_surface(
        dataclasses.replace(MEASUREMENTS, power_dbm=power), CHANNEL, has_prior=False
    )
    centre = np.array(CHANNEL.station.position_m)
    _, _, curvature = gauss_newton(surface, centre)
    step = 1e-3 * np.eye(2)
    hessian = [
        (gauss_newton(surface, centre + one)[1] - gauss_newton(surface, centre - one)[1]) / 2e-3
        for one in step
    ]
    np.testing.assert_allclose(curvature, hessian, rtol=1e-4)


def test_power_that_grows_with_the_distance_is_no_candidate():
    """From the far side of a power that falls away from it, n_PL would be negative."""
    positions = np.random.default_rng(0).uniform(0.0, 100.0, (30, 2))
    measurements = Measurements(positions, -60.0 - 0.2 * positions[:, 0], np.zeros(30, bool))
    surface = station_surface(measurements, CHANNEL, has_prior=False)
    found = losses(surface, np.array([[-50.0, 50.0], [150.0, 50.0]])).loss
    assert np.isfinite(found[0]) and np.isinf(found[1])


def test_all_that_is_known_of_measurements_is_in_the_covariance():
    """Rounding, position errors and age, as in the likelihood of the fit."""
    channel = dataclasses.replace(CHANNEL, forgetting_s=100.0)
    plain = simulated(channel, 3, 12, 200.0)
    known = dataclasses.replace(
        plain,
        resolution_db=np.full(12, 1.0),
        position_std_m=np.full(12, 5.0),
        time_s=np.arange(12) * 50.0,
    )
    values, covariance = gaussian_covariance_db2(known, channel)
    _, bare = gaussian_covariance_db2(plain, channel)
    np.testing.assert_allclose(values, plain.power_dbm)
    assert (np.diag(covariance) > np.diag(bare) + 1.0 / 12.0).all()
    assert covariance[0, 11] < bare[0, 11] * math.exp(-5.4)
