"""The posterior against scikit-learn, dense formulas, sequential updating and simulation."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm
from simulated_channel import subset

from planopt.channel import ChannelParameters, Measurements, Station, condition
from planopt.channel.measurements import join, shadow_covariance_db2
from planopt.channel.parameters import regressors
from planopt.channel.posterior import WEAK_THETA_DEVIATION

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))
THETA = np.array([PARAMETERS.k_pl_db, PARAMETERS.n_pl])


def measured(count, seed=0, censored=()):
    """Random measurements about the model's path loss."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(-100.0, 100.0, (count, 2))
    power = regressors(positions, PARAMETERS.station) @ THETA + 6.0 * generator.standard_normal(
        count
    )
    flags = np.zeros(count, dtype=bool)
    flags[list(censored)] = True
    return Measurements(positions, power, flags)


def places(count=40, seed=9):
    return np.random.default_rng(seed).uniform(-120.0, 120.0, (count, 2))


def dense(data, positions):
    """Theta, M, mean and deviation by equations 1.6 to 1.8, with dense inverses."""
    covariance = shadow_covariance_db2(data.positions_m, data.positions_m, PARAMETERS)
    inverse = np.linalg.inv(covariance + 4.0 * np.eye(len(data)))
    gamma_all = regressors(data.positions_m, PARAMETERS.station)
    spread = np.linalg.inv(gamma_all.T @ inverse @ gamma_all)
    theta = spread @ gamma_all.T @ inverse @ data.power_dbm
    means, deviations = [], []
    for position in positions:
        phi = shadow_covariance_db2(data.positions_m, position[None], PARAMETERS)[:, 0]
        gamma = regressors(position[None], PARAMETERS.station)[0]
        trend = gamma - gamma_all.T @ inverse @ phi
        means.append(gamma @ theta + phi @ inverse @ (data.power_dbm - gamma_all @ theta))
        deviations.append(np.sqrt(40.0 - phi @ inverse @ phi + trend @ spread @ trend))
    return theta, spread, np.array(means), np.array(deviations)


@pytest.mark.parametrize("count", [3, 16, 700])
def test_estimated_theta_equals_dense_universal_kriging(count):
    """Theta, its covariance, mean and deviation; 700 crosses the factor's and solver's blocks."""
    data = measured(count)
    posterior = condition(PARAMETERS, data)
    theta, spread, mean, deviation = dense(data, places())
    found = posterior.predict(places())
    np.testing.assert_allclose(posterior.theta, theta, atol=1e-8)
    np.testing.assert_allclose(posterior.theta_covariance, spread, atol=1e-8)
    np.testing.assert_allclose(found.mean_db, mean, atol=1e-8)
    np.testing.assert_allclose(found.deviation_db, deviation, atol=1e-8)


def test_branches_of_one_posterior_do_not_disturb_each_other():
    """Two different extensions of the same posterior share a buffer, and each is right."""
    data = measured(40)
    root = condition(PARAMETERS, subset(data, slice(0, 20)))
    first = root.extend(subset(data, slice(20, 30)))
    second = root.extend(subset(data, slice(30, 40)))
    again = first.extend(subset(data, slice(30, 40)))
    for posterior, chosen in (
        (root, list(range(20))),
        (first, list(range(30))),
        (second, [*range(20), *range(30, 40)]),
        (again, list(range(40))),
    ):
        expected = condition(PARAMETERS, subset(data, chosen)).predict(places())
        found = posterior.predict(places())
        np.testing.assert_allclose(found.mean_db, expected.mean_db, atol=1e-10)
        np.testing.assert_allclose(found.deviation_db, expected.deviation_db, atol=1e-10)


@pytest.mark.parametrize(
    "parameters",
    [
        ChannelParameters(-40.0, 3.0, 6.0, 30.0, 0.0, Station((0.0, 0.0))),
        ChannelParameters(-40.0, 3.0, 0.0, 30.0, 0.0, Station((0.0, 0.0))),
        ChannelParameters(-40.0, 3.0, 0.0, 30.0, 2.0, Station((0.0, 0.0))),
        ChannelParameters(-40.0, 3.0, 6.0, 1e6, 2.0, Station((0.0, 0.0))),
        ChannelParameters(-40.0, 3.0, 6.0, 1e-3, 2.0, Station((0.0, 0.0))),
    ],
)
def test_degenerate_parameters_with_duplicates_stay_finite(parameters):
    """No noise, no shadowing, extreme decorrelation; a measurement at the station; duplicates."""
    data = measured(12)
    twice = join(data, data)
    twice.positions_m[3] = 0.0
    posterior = condition(parameters, twice)
    found = posterior.predict(np.concatenate([places(), twice.positions_m]))
    assert np.isfinite(found.mean_db).all()
    assert (found.deviation_db >= parameters.multipath_std_db - 1e-12).all()


def test_coordinates_near_three_million_keep_their_digits():
    data = measured(50)
    shift = np.array([3e6, 5e6])
    moved = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((3000005.0, 4999990.0), 12.0))
    one = condition(PARAMETERS, data).predict(places())
    two = condition(
        moved, Measurements(data.positions_m + shift, data.power_dbm, data.censored)
    ).predict(places() + shift)
    np.testing.assert_allclose(one.mean_db, two.mean_db, atol=1e-6)
    np.testing.assert_allclose(one.deviation_db, two.deviation_db, atol=1e-6)


def test_no_measurements_give_the_weak_prior():
    """Nothing measured: the given theta, its weak deviation, full shadowing."""
    posterior = condition(PARAMETERS, measured(0))
    np.testing.assert_array_equal(posterior.theta, THETA)
    np.testing.assert_allclose(
        posterior.theta_covariance, np.diag(np.square(WEAK_THETA_DEVIATION)), rtol=1e-12
    )
    gamma = regressors(places(), PARAMETERS.station)
    found = posterior.predict(places())
    np.testing.assert_allclose(found.mean_db, gamma @ THETA, rtol=1e-12)
    np.testing.assert_allclose(
        found.deviation_db**2, 40.0 + gamma**2 @ np.square(WEAK_THETA_DEVIATION), rtol=1e-12
    )


@pytest.mark.parametrize("count", [1, 12])
def test_one_distance_from_the_station_takes_the_weak_prior(count):
    """One distance identifies one combination of theta only; the rest stays at its prior."""
    angle = np.linspace(0.0, 6.0, count)
    station = PARAMETERS.station.position_m
    positions = np.array(station) + 50.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    data = Measurements(positions, np.full(count, -110.0), np.zeros(count, dtype=bool))
    posterior = condition(PARAMETERS, data)
    gamma = regressors(positions[:1], PARAMETERS.station)[0]
    prior = np.diag(np.square(WEAK_THETA_DEVIATION))
    # Orthogonal, in the prior's metric, to what is measured nothing is learnt.
    blind = np.array([gamma[1], -gamma[0]])
    assert blind @ np.linalg.inv(posterior.theta_covariance) @ blind == pytest.approx(
        blind @ np.linalg.inv(prior) @ blind, rel=1e-6
    )
    assert gamma @ posterior.theta_covariance @ gamma < 41.0
    assert gamma @ posterior.theta < gamma @ THETA
    assert np.isfinite(posterior.predict(places()).deviation_db).all()


@pytest.mark.parametrize("resolution", [None, 5.0, 12.0])
def test_an_interval_matches_the_truncated_moments(resolution):
    """Extending by a limit or a coarse power: mean and variance of the truncated prediction."""
    posterior = condition(PARAMETERS, measured(15), theta="known")
    spot = np.array([[20.0, 30.0]])
    before = posterior.predict(spot)
    power = before.mean_db + (2.0 if resolution else -3.0)
    step = np.array([resolution or 0.0])
    after = posterior.extend(Measurements(spot, power, step == 0.0, step)).predict(spot)
    deviation = np.sqrt(before.deviation_db[0] ** 2 - 4.0)
    latent = before.mean_db[0] + deviation * np.linspace(-12.0, 12.0, 200_001)
    inside = norm.cdf((power[0] + 0.5 * step - latent) / 2.0)
    if resolution:
        inside -= norm.cdf((power[0] - 0.5 * step - latent) / 2.0)
    density = norm.pdf(latent, before.mean_db[0], deviation) * inside
    density /= density.sum()
    mean = density @ latent
    assert after.mean_db[0] == pytest.approx(mean, abs=1e-6)
    variance = density @ (latent - mean) ** 2
    assert after.deviation_db[0] ** 2 - 4.0 == pytest.approx(variance, abs=1e-5)


def test_censored_measurements_mix_with_others():
    """Sites of a batch and of an extension are finite, and only censored ones are changed."""
    data = measured(30, censored=(3, 17, 18, 29))
    batch = condition(PARAMETERS, data)
    grown = condition(PARAMETERS, subset(data, slice(0, 10))).extend(subset(data, slice(10, 30)))
    for posterior in (batch, grown):
        assert np.isfinite(posterior.predict(places()).deviation_db).all()
        np.testing.assert_array_equal(
            posterior.values_db[~data.censored], data.power_dbm[~data.censored]
        )
        assert (posterior.noise_variance_db2[data.censored] > 4.0).all()
        np.testing.assert_array_equal(posterior.noise_variance_db2[~data.censored], 4.0)
    np.testing.assert_array_equal(grown.measurements.power_dbm, data.power_dbm)


def test_fine_steps_widen_the_noise_in_a_batch_and_in_extensions():
    """Steps up to twice omega: value kept, omega^2 + r^2 / 12; batch and sequence agree."""
    data = dataclasses.replace(measured(20), resolution_db=np.repeat([0.0, 3.0], 10))
    batch = condition(PARAMETERS, data)
    grown = condition(PARAMETERS, data.take(slice(0, 7))).extend(data.take(slice(7, 20)))
    for posterior in (batch, grown):
        np.testing.assert_array_equal(posterior.values_db, data.power_dbm)
        np.testing.assert_allclose(posterior.noise_variance_db2, np.repeat([4.0, 4.75], 10))
    np.testing.assert_allclose(
        grown.predict(places()).mean_db, batch.predict(places()).mean_db, rtol=1e-10
    )


@pytest.mark.parametrize("count", [0, 1, 150])
def test_many_places_equal_few(count):
    """A map's in-place solve gives what a few places at a time give, extended factor included."""
    posterior = condition(PARAMETERS, measured(count)).extend(measured(5, seed=3))
    everywhere = places(2500)
    whole = posterior.predict(everywhere)
    parts = [posterior.predict(some) for some in np.array_split(everywhere, 5)]
    np.testing.assert_allclose(
        whole.mean_db, np.concatenate([one.mean_db for one in parts]), rtol=1e-11
    )
    np.testing.assert_allclose(
        whole.deviation_db, np.concatenate([one.deviation_db for one in parts]), rtol=1e-11
    )
