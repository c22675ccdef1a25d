"""Censored and rounded measurements as Gaussian ones, against sampling and limits."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.gaussian_sites import MAX_SITE_VARIANCE_DB2, gaussian_sites, needs_site
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors

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


def rounded(power, positions, step_db, floor=-np.inf):
    """Powers rounded to whole steps, cut at a floor."""
    near = np.round(power / step_db) * step_db
    resolution = np.full(len(power), float(step_db))
    return Measurements(positions, np.maximum(near, floor), near <= floor, resolution)


def posterior(measurements, sites, channel=CHANNEL):
    """Mean and covariance of the noise-free power at the measured positions."""
    prior = shadow_covariance_db2(measurements.positions_m, measurements.positions_m, channel)
    mean = regressors(measurements.positions_m, channel.station) @ [channel.k_pl_db, channel.n_pl]
    gain = prior @ np.linalg.inv(prior + np.diag(sites.noise_variance_db2))
    return mean + gain @ (sites.values_db - mean), prior - gain @ prior


def test_rounded_posterior_agrees_with_gibbs_sampling():
    """Coarse steps, a floor at the end of one: sampling the noise within each interval agrees."""
    exact, power = simulated(4, share=0.0)
    measurements = rounded(power, exact.positions_m, 8.0, floor=-104.0)
    censored = measurements.censored
    assert needs_site(measurements, 4.0).all() and 2 < censored.sum() < 20
    mean, covariance = posterior(measurements, gaussian_sites(CHANNEL, measurements))
    prior = shadow_covariance_db2(exact.positions_m, exact.positions_m, CHANNEL)
    path_loss = regressors(exact.positions_m, CHANNEL.station) @ [-40.0, 3.0]
    gain = prior @ np.linalg.inv(prior + 4.0 * np.eye(40))
    root = np.linalg.cholesky(prior - gain @ prior + 1e-9 * np.eye(40))
    rng = np.random.default_rng(1)
    upper = measurements.power_dbm + 4.0
    lower = np.where(censored, -np.inf, upper - 8.0)
    power = measurements.power_dbm.copy()
    draws = []
    for _ in range(6000):
        f = path_loss + gain @ (power - path_loss) + root @ rng.standard_normal(40)
        low, high = norm.cdf((lower - f) / 2.0), norm.cdf((upper - f) / 2.0)
        power = f + 2.0 * norm.ppf(low + rng.uniform(size=40) * (high - low))
        draws.append(f)
    draws = np.array(draws[500:])
    np.testing.assert_allclose(mean, draws.mean(0), atol=0.3)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), draws.std(0), rtol=0.12)


def test_only_the_rounded_and_censored_are_changed():
    """Exact, finely and coarsely rounded and censored ones stand in one log."""
    exact, power = simulated(8, share=0.0)
    resolution = np.repeat([0.0, 1.0, 9.0, 0.0], 10)
    censored = np.arange(40) >= 30
    measurements = Measurements(exact.positions_m, power, censored, resolution)
    np.testing.assert_array_equal(needs_site(measurements, 4.0), np.arange(40) >= 20)
    sites = gaussian_sites(CHANNEL, measurements)
    np.testing.assert_array_equal(sites.values_db[:20], power[:20])
    np.testing.assert_allclose(
        sites.noise_variance_db2[:20], np.repeat([4.0, 4.0 + 1.0 / 12.0], 10)
    )
    assert (np.abs(sites.values_db - power)[20:30] < 9.0).all()
    assert (sites.values_db != power)[20:].all()
    assert (np.abs(sites.noise_variance_db2[20:30] / (4.0 + 6.75) - 1.0) < 0.5).all()


def test_what_a_limit_tells():
    """A limit far above says nothing; beside an exact value an uncertain place says less."""
    positions = np.array([[50.0, 0.0], [50.5, 0.0]])
    flags = np.array([False, True])
    sharp = Measurements(positions, np.array([-90.0, -95.0]), flags)
    vague = dataclasses.replace(sharp, position_std_m=np.full(2, 20.0))
    first, second = gaussian_sites(CHANNEL, sharp), gaussian_sites(CHANNEL, vague)
    assert second.noise_variance_db2[1] != pytest.approx(first.noise_variance_db2[1], rel=0.05)
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


@pytest.mark.parametrize("omega", [0.0, 1e-6, 2.0])
@pytest.mark.parametrize("shadow", [0.0, 6.0, 40.0])
@pytest.mark.parametrize("floor", [-400.0, -90.0, 200.0])
def test_hard_cases_stay_finite_and_positive(omega, shadow, floor):
    """All censored or rounded, repeated places, no multipath, absurd powers: finite, positive."""
    channel = dataclasses.replace(CHANNEL, multipath_std_db=omega, shadow_std_db=shadow)
    positions = np.repeat(np.random.default_rng(0).uniform(-50, 50, (10, 2)), 3, axis=0)
    for censored in (np.ones(30, bool), np.arange(30) % 2 == 0):
        for step in (0.0, 5.0):
            known = Measurements(positions, np.full(30, floor), censored, np.full(30, step))
            sites = gaussian_sites(channel, known)
            assert np.isfinite(sites.values_db).all()
            changed = sites.noise_variance_db2[needs_site(known, omega**2)]
            assert (changed > 0).all() and (changed <= MAX_SITE_VARIANCE_DB2).all()
