"""Sites matched in windows: evidence of few, and joint sites of many measurements."""

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.gaussian_sites import gaussian_sites, intervals
from planopt.channel.long_logs import SITE_NEIGHBOURS, IntervalRows, neighbour_sites, window_sites
from planopt.channel.measurements import measured_origins, own_covariance_db2
from planopt.channel.neighbours import place_blocks, surrounding_windows
from planopt.channel.parameters import regressors

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def settled(measurements, mean_db, start=None, tolerance=1e-6, block=48, near=64):
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
            surrounding_windows(places, tuple(blocks), near),
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


def test_slope_is_that_of_the_likelihood_alone():
    """With one limit: the derivative by omega^2 with the cavity held."""
    measurements = Measurements(np.zeros((1, 2)), np.array([-99.0]), np.ones(1, dtype=bool))
    # Nobody else speaks for it: the cavity is the prior.
    spread = math.sqrt(36.0 + 4.0)
    below = (-99.0 + 95.0) / spread
    hazard = norm.pdf(below) / norm.cdf(below)
    expected = -0.5 * hazard * below / spread**2
    assert settled(measurements, -95.0).slope == pytest.approx(expected, rel=1e-9)


PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def sample(count, share, seed=0, **more):
    """Random measurements about path loss, the weakest `share` at the receiver's floor."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(-100.0, 100.0, (count, 2))
    mean = regressors(positions, PARAMETERS.station) @ [PARAMETERS.k_pl_db, PARAMETERS.n_pl]
    power = mean + 6.0 * generator.standard_normal(count)
    floor = np.quantile(power, share)
    return Measurements(positions, np.maximum(power, floor), power <= floor, **more)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_with_all_neighbours_they_are_the_joint_sites(share):
    """The same fixed point, to the tolerance of either."""
    data = sample(SITE_NEIGHBOURS + 1, share)
    found, joint = neighbour_sites(PARAMETERS, data), gaussian_sites(PARAMETERS, data)
    np.testing.assert_allclose(found.values_db, joint.values_db, atol=0.05)
    precision = 1.0 / joint.noise_variance_db2
    np.testing.assert_allclose(1.0 / found.noise_variance_db2, precision, rtol=1e-3, atol=1e-5)
    exact = ~data.censored
    np.testing.assert_array_equal(found.values_db[exact], data.power_dbm[exact])
    np.testing.assert_array_equal(found.noise_variance_db2[exact], 4.0)


def test_coarse_steps_and_position_errors_are_counted():
    """Rounded, displaced and by several receivers: still the joint sites."""
    generator = np.random.default_rng(1)
    data = sample(
        60,
        0.3,
        resolution_db=np.where(np.arange(60) % 2, 6.0, 0.0),
        position_std_m=generator.uniform(0.0, 5.0, 60),
        receiver=generator.integers(0, 3, 60),
    )
    found, joint = neighbour_sites(PARAMETERS, data), gaussian_sites(PARAMETERS, data)
    np.testing.assert_allclose(found.values_db, joint.values_db, atol=0.1)
    np.testing.assert_allclose(found.noise_variance_db2, joint.noise_variance_db2, rtol=0.02)


def test_many_limits_at_one_place():
    """More limits at one place than neighbours: none counts itself, all sites are the same."""
    data = Measurements(
        np.full((2 * SITE_NEIGHBOURS, 2), 20.0),
        np.full(2 * SITE_NEIGHBOURS, -110.0),
        np.ones(2 * SITE_NEIGHBOURS, dtype=bool),
    )
    found = neighbour_sites(PARAMETERS, data)
    np.testing.assert_allclose(found.values_db, found.values_db[0], rtol=1e-4)
    assert (found.noise_variance_db2 > 4.0).all()
