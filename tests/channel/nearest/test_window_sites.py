"""Sites matched in windows, and the evidence that goes with them."""

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.gaussian_sites import intervals
from planopt.channel.measurement_covariance import (
    measured_origins,
    own_covariance_db2,
)
from planopt.channel.neighbours import place_blocks, surrounding_windows
from planopt.channel.window_sites import IntervalRows, window_sites

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def settled(measurements, mean_db, start=None, tolerance=1e-6, block=48, beside=64):
    """Sites of the censored measurements."""
    rows = np.flatnonzero(measurements.censored)
    places = measurements.positions_m
    blocks = [own for own in place_blocks(places, block) if measurements.censored[own].any()]
    return window_sites(
        CHANNEL,
        measured_origins(measurements, CHANNEL),
        (measurements.power_dbm, np.full(len(measurements), 4.0)),
        IntervalRows(
            rows,
            intervals(measurements.take(rows)),
            np.zeros(len(rows)),
            surrounding_windows(places, tuple(blocks), beside),
        ),
        np.full(len(measurements), mean_db),
        start,
        tolerance,
    )


def density(measurements, mean_db, sites):
    """Log of the probability of all: that of the Gaussian ones, sites as such, and the factor."""
    covariance = own_covariance_db2(measured_origins(measurements, CHANNEL), CHANNEL)
    noise, values = np.full(len(measurements), 4.0), measurements.power_dbm.copy()
    rows = measurements.censored
    noise[rows], values[rows] = 1.0 / sites.precision, sites.values_db
    normal = multivariate_normal(np.full(len(values), mean_db), covariance + np.diag(noise))
    return normal.logpdf(values) + sites.log_factor


def test_one_limit_is_exact():
    """With one interval the probability is the Gaussian density by the conditional probability."""
    measurements = Measurements(
        np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 25.0]]),
        np.array([-100.0, -93.0, -96.0]),
        np.array([True, False, False]),
    )
    covariance = own_covariance_db2(measured_origins(measurements, CHANNEL), CHANNEL)
    covariance += 4.0 * np.eye(3)
    weights = np.linalg.solve(covariance[1:, 1:], covariance[1:, 0])
    about = measurements.power_dbm + 95.0
    mean, variance = weights @ about[1:], covariance[0, 0] - weights @ covariance[1:, 0]
    expected = norm.logcdf((about[0] - mean) / math.sqrt(variance))
    expected += multivariate_normal(np.zeros(2), covariance[1:, 1:]).logpdf(about[1:])
    assert density(measurements, -95.0, settled(measurements, -95.0)) == pytest.approx(
        expected, abs=1e-6
    )


def test_two_limits_are_nearly_the_bivariate_normal():
    """Expectation propagation of a two-dimensional probability is good to some thousandths."""
    measurements = Measurements(
        np.array([[0.0, 0.0], [12.0, 0.0]]), np.array([-99.0, -97.0]), np.ones(2, dtype=bool)
    )
    covariance = own_covariance_db2(measured_origins(measurements, CHANNEL), CHANNEL)
    normal = multivariate_normal(np.full(2, -95.0), covariance + 4.0 * np.eye(2))
    expected = float(np.log(normal.cdf(measurements.power_dbm)))
    assert density(measurements, -95.0, settled(measurements, -95.0)) == pytest.approx(
        expected, abs=5e-3
    )


def test_slope_is_that_of_the_likelihood_alone():
    """With one limit: the derivative by omega^2 with the cavity held."""
    measurements = Measurements(np.zeros((1, 2)), np.array([-99.0]), np.ones(1, dtype=bool))
    # Nobody else speaks for it: the cavity is the prior.
    spread = math.sqrt(36.0 + 4.0)
    below = (-99.0 + 95.0) / spread
    hazard = norm.pdf(below) / norm.cdf(below)
    expected = -0.5 * hazard * below / spread**2
    assert settled(measurements, -95.0).slope == pytest.approx(expected, rel=1e-9)
