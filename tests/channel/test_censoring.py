"""Expectation propagation for censored measurements, against closed forms and quadrature."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from planopt.channel.censoring import MAX_SITE_VARIANCE_DB2, censored_sites, gaussian_sites
from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.path_loss import regressors

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((0.0, 0.0), 10.0))


def simulated(seed, count=40, share=0.3):
    """Measurements of CHANNEL with the weakest share censored."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-100, 100, (count, 2))
    covariance = shadow_covariance_db2(positions, positions, CHANNEL)
    covariance += CHANNEL.multipath_std_db**2 * np.eye(count)
    mean = regressors(positions, CHANNEL.station) @ [CHANNEL.k_pl_db, CHANNEL.n_pl]
    power = mean + np.linalg.cholesky(covariance) @ rng.standard_normal(count)
    floor = np.quantile(power, share)
    return Measurements(positions, np.maximum(power, floor), power <= floor), power


def posterior(measurements, sites, channel=CHANNEL):
    """Mean and covariance of the noise-free power at the measured positions."""
    prior = shadow_covariance_db2(measurements.positions_m, measurements.positions_m, channel)
    mean = regressors(measurements.positions_m, channel.station) @ [channel.k_pl_db, channel.n_pl]
    gain = prior @ np.linalg.inv(prior + np.diag(sites.noise_variance_db2))
    return mean + gain @ (sites.values_db - mean), prior - gain @ prior


def test_without_censoring_values_and_omega_pass_through():
    """Uncensored measurements keep their power and get variance omega^2."""
    measurements, _ = simulated(0, share=-0.0)
    measurements = dataclasses.replace(measurements, censored=np.zeros(40, bool))
    sites = gaussian_sites(CHANNEL, measurements)
    np.testing.assert_array_equal(sites.values_db, measurements.power_dbm)
    np.testing.assert_array_equal(sites.noise_variance_db2, 4.0)


def test_one_limit_matches_the_exact_tilted_moments():
    """With one site EP is exact: mean, variance and evidence agree with numerical integration."""
    mean, variance, upper, omega2 = -80.0, 25.0, -84.0, 4.0
    found = censored_sites(np.array([mean]), np.array([[variance]]), np.array([upper]), omega2)
    f = np.linspace(mean - 60, mean + 60, 200_001)
    weight = norm.pdf(f, mean, np.sqrt(variance)) * norm.cdf((upper - f) / np.sqrt(omega2))
    step = f[1] - f[0]
    mass = weight.sum() * step
    exact_mean = (f * weight).sum() * step / mass
    exact_variance = ((f - exact_mean) ** 2 * weight).sum() * step / mass
    total = 1.0 / variance + found.precision[0]
    assert mean + found.shift[0] / total == pytest.approx(exact_mean, abs=1e-6)
    assert 1.0 / total == pytest.approx(exact_variance, rel=1e-6)
    assert found.log_evidence == pytest.approx(np.log(mass), abs=1e-8)


def test_evidence_of_three_correlated_limits_is_the_orthant_probability():
    """EP's log evidence is close to the multivariate normal probability below the limits."""
    covariance = 16.0 * np.exp(-np.abs(np.subtract.outer([0, 1, 3.0], [0, 1, 3.0])) / 2.0)
    mean, upper = np.array([-80.0, -82.0, -79.0]), np.array([-81.0, -81.0, -81.0])
    found = censored_sites(mean, covariance, upper, 1.0)
    exact = multivariate_normal(mean, covariance + np.eye(3)).cdf(upper)
    assert found.log_evidence == pytest.approx(np.log(exact), abs=0.01)


def test_slope_is_the_derivative_of_the_evidence_by_omega():
    """At the fixed point the evidence moves with omega^2 through the likelihood alone."""
    covariance = 16.0 * np.exp(-np.abs(np.subtract.outer([0, 1, 3.0], [0, 1, 3.0])) / 2.0)
    arguments = np.full(3, -80.0), covariance, np.array([-83.0, -81.0, -84.0])
    up, down = (censored_sites(*arguments, 2.0 + d).log_evidence for d in (1e-4, -1e-4))
    slope = censored_sites(*arguments, 2.0).evidence_slope
    assert slope == pytest.approx((up - down) / 2e-4, rel=1e-4)


def test_posterior_agrees_with_gibbs_sampling():
    """Means and deviations at all points agree with sampling the truncated noise directly."""
    measurements, _ = simulated(3)
    mean, covariance = posterior(measurements, gaussian_sites(CHANNEL, measurements))
    prior = shadow_covariance_db2(measurements.positions_m, measurements.positions_m, CHANNEL)
    path_loss = regressors(measurements.positions_m, CHANNEL.station) @ [-40.0, 3.0]
    gain = prior @ np.linalg.inv(prior + 4.0 * np.eye(40))
    root = np.linalg.cholesky(prior - gain @ prior + 1e-9 * np.eye(40))
    rng = np.random.default_rng(1)
    power = measurements.power_dbm.copy()
    censored = measurements.censored
    draws = []
    for _ in range(6000):
        f = path_loss + gain @ (power - path_loss) + root @ rng.standard_normal(40)
        below = norm.cdf((measurements.power_dbm - f)[censored] / 2.0)
        power[censored] = f[censored] + 2.0 * norm.ppf(rng.uniform(size=censored.sum()) * below)
        draws.append(f)
    draws = np.array(draws[500:])
    np.testing.assert_allclose(mean, draws.mean(0), atol=0.5)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), draws.std(0), rtol=0.12)


def test_an_uninformative_limit_changes_nothing():
    """A limit far above what is expected has a capped variance and leaves the posterior alone."""
    measurements, power = simulated(5, share=0.1)
    where = int(np.argmin(power))
    high = np.where(measurements.censored, 100.0, measurements.power_dbm)
    measurements = Measurements(measurements.positions_m, high, measurements.censored)
    sites = gaussian_sites(CHANNEL, measurements)
    assert sites.noise_variance_db2[where] == pytest.approx(MAX_SITE_VARIANCE_DB2)
    keep = ~measurements.censored
    without = Measurements(
        measurements.positions_m[keep], measurements.power_dbm[keep], measurements.censored[keep]
    )
    mean, _ = posterior(measurements, sites)
    expected, _ = posterior(without, gaussian_sites(CHANNEL, without))
    np.testing.assert_allclose(mean[keep], expected, atol=0.01)


def test_order_does_not_matter():
    """Permuting the measurements permutes the sites."""
    measurements, _ = simulated(6)
    order = np.random.default_rng(0).permutation(len(measurements))
    shuffled = Measurements(
        measurements.positions_m[order],
        measurements.power_dbm[order],
        measurements.censored[order],
    )
    sites, again = gaussian_sites(CHANNEL, measurements), gaussian_sites(CHANNEL, shuffled)
    np.testing.assert_allclose(again.values_db, sites.values_db[order], atol=1e-4)


@pytest.mark.parametrize("omega", [0.0, 1e-6, 2.0])
@pytest.mark.parametrize("shadow", [0.0, 6.0, 40.0])
@pytest.mark.parametrize("floor", [-400.0, -90.0, 200.0])
def test_hard_cases_stay_finite_and_positive(omega, shadow, floor):
    """All censored, repeated positions, no multipath, absurd limits: finite positive variances."""
    channel = dataclasses.replace(CHANNEL, multipath_std_db=omega, shadow_std_db=shadow)
    positions = np.repeat(np.random.default_rng(0).uniform(-50, 50, (10, 2)), 3, axis=0)
    for censored in (np.ones(30, bool), np.arange(30) % 2 == 0):
        sites = gaussian_sites(channel, Measurements(positions, np.full(30, floor), censored))
        assert np.isfinite(sites.values_db).all()
        limits = sites.noise_variance_db2[censored]
        assert (limits > 0).all() and (limits <= MAX_SITE_VARIANCE_DB2).all()
