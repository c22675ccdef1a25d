"""Theta by both estimators: dense formulas, equation 1.10, and the error by simulation."""

import dataclasses

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Measurements, Station, condition
from planopt.channel.kriging import kriging_terms
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))


def design(measurements):
    gamma = regressors(measurements.positions_m, CHANNEL.station)
    within = shadow_covariance_db2(measurements.positions_m, measurements.positions_m, CHANNEL)
    return gamma, within + CHANNEL.multipath_std_db**2 * np.eye(len(gamma))


def test_dense_formulas():
    """Both estimates and their covariances are the textbook's."""
    measurements = simulated(CHANNEL, 0, 40, 200.0)
    gamma, covariance = design(measurements)
    weight = np.linalg.inv(covariance)
    spread = np.linalg.inv(gamma.T @ weight @ gamma)
    ml = condition(CHANNEL, measurements)
    np.testing.assert_allclose(ml.theta_covariance, spread, rtol=1e-8)
    np.testing.assert_allclose(ml.theta, spread @ gamma.T @ weight @ measurements.power_dbm)
    normal = np.linalg.inv(gamma.T @ gamma)
    ls = condition(CHANNEL, measurements, theta="least_squares")
    middle = gamma.T @ covariance @ gamma
    np.testing.assert_allclose(ls.theta_covariance, normal @ middle @ normal, rtol=1e-8)
    np.testing.assert_allclose(
        ls.theta, np.linalg.lstsq(gamma, measurements.power_dbm, rcond=None)[0]
    )


def test_lemma_3_equals_the_batch():
    """Measuring along a path, the recursion gives the batch's M at every step to 1e-10."""
    measurements = simulated(CHANNEL, 2, 20, 200.0)
    path = np.stack([np.linspace(0.0, 90.0, 15), np.linspace(20.0, 0.0, 15)], axis=1)
    path[7] = measurements.positions_m[3]
    posterior = condition(CHANNEL, measurements)
    for place in path:
        terms, before = kriging_terms(posterior, place[None]), posterior.theta_covariance
        information = np.outer(terms.trend[0], terms.trend[0]) / terms.variance_db2[0]
        recursion = np.linalg.inv(np.linalg.inv(before) + information)
        one = Measurements(place[None], np.array([-80.0]), np.zeros(1, bool))
        posterior = posterior.extend(one)
        batch = condition(CHANNEL, posterior.measurements).theta_covariance
        np.testing.assert_allclose(recursion, batch, rtol=1e-9)


def test_prediction_with_least_squares_theta_is_calibrated():
    """Its variance is the mean square error over drawn channels, larger than the ml one's."""
    first = simulated(CHANNEL, 4, 12, 150.0)
    places = np.array([[10.0, 140.0], [75.0, 75.0], [400.0, 300.0]])
    everywhere = np.concatenate([first.positions_m, places])
    whole = Measurements(everywhere, np.zeros(15), np.zeros(15, bool))
    gamma, covariance = design(whole)
    rng = np.random.default_rng(1)
    powers = gamma @ [CHANNEL.k_pl_db, CHANNEL.n_pl] + (
        rng.standard_normal((3000, 15)) @ np.linalg.cholesky(covariance).T
    )
    squares = np.zeros(3)
    for power in powers:
        seen = dataclasses.replace(first, power_dbm=power[:12])
        found = condition(CHANNEL, seen, theta="least_squares").predict(places)
        squares += (found.mean_db - power[12:]) ** 2
    np.testing.assert_allclose(squares / len(powers), found.deviation_db**2, rtol=0.1)
    best = condition(CHANNEL, seen).predict(places)
    assert (found.deviation_db >= best.deviation_db - 1e-12).all()
    assert found.deviation_db[2] > 1.005 * best.deviation_db[2]


def test_receiver_offsets_do_not_enter_least_squares():
    """A constant added to all powers of another receiver moves theta by nothing."""
    measurements = simulated(CHANNEL, 6, 30, 200.0)
    mixed = dataclasses.replace(measurements, receiver=np.arange(30) % 2)
    shifted = dataclasses.replace(mixed, power_dbm=mixed.power_dbm + 7.0 * mixed.receiver)
    first, second = (condition(CHANNEL, m, theta="least_squares") for m in (mixed, shifted))
    np.testing.assert_allclose(second.theta, first.theta, rtol=1e-9)
    np.testing.assert_allclose(second.theta_covariance, first.theta_covariance, rtol=1e-9)


def test_censored_ones_are_left_out_of_least_squares():
    measurements = simulated(CHANNEL, 7, 30, 200.0)
    flags = np.arange(30) >= 25
    limited = dataclasses.replace(measurements, censored=flags)
    with_limits = condition(CHANNEL, limited, theta="least_squares")
    without = condition(CHANNEL, measurements.take(~flags), theta="least_squares")
    np.testing.assert_allclose(with_limits.theta, without.theta, rtol=1e-9)
    np.testing.assert_allclose(with_limits.theta_covariance, without.theta_covariance, rtol=1e-9)


@pytest.mark.parametrize("how", ["estimated", "least_squares"])
def test_unidentified_theta_has_the_weak_prior(how):
    """From one measurement, or none, both are the same finite estimate."""
    for count in (0, 1):
        few = simulated(CHANNEL, 8, 5, 200.0).take(slice(0, count))
        found = condition(CHANNEL, few, theta=how)
        assert np.isfinite(found.theta).all()
        np.testing.assert_allclose(
            found.theta_covariance, condition(CHANNEL, few).theta_covariance, rtol=1e-12
        )
