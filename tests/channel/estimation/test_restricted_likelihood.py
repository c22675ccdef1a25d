"""The restricted likelihood and its gradient."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.stats import multivariate_normal
from simulated_channel import simulated
from varied_measurements import DRIFTING, dense_covariance, varied

from planopt.channel.estimation.likelihood_data import likelihood_data
from planopt.channel.estimation.restricted_likelihood import (
    evaluate,
    expected_information,
    profiled_log_likelihood,
)
from planopt.channel.measurement_covariance import measured_path_loss_variance_db2
from planopt.channel.parameters import ChannelParameters, Station, mean_model

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))
POINT = (30.0, 5.0, 25.0)


def data_of(measurements, both=True, as_interval=None):
    """Likelihood data with the full or the one-column mean."""
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, CHANNEL.station, both)
    return likelihood_data(model, measurements, CHANNEL, as_interval)


def rounded(measurements, step_db):
    """The measurements rounded to whole steps; the censored ones keep their limits."""
    power = np.round(measurements.power_dbm / step_db) * step_db
    power = np.where(measurements.censored, measurements.power_dbm, power)
    resolution = np.where(measurements.censored, 0.0, step_db)
    return replace(measurements, power_dbm=power, resolution_db=resolution)


def intervals_of(measurements, rows):
    """The data with rows, beside the censored ones, as intervals."""
    chosen = measurements.censored.copy()
    chosen[rows] = True
    return data_of(measurements, as_interval=chosen)


def covariance_at(data, point):
    """V of exact measurements."""
    return point[0] * np.exp(-data.distance_m / point[2]) + point[1] * np.eye(len(data.power_db))


def test_is_the_density_of_contrasts():
    """The value is the density of error contrasts: up to log |G'G| / 2, which is constant."""
    data = data_of(simulated(CHANNEL, 0, 40, 200.0))
    basis = null_space(data.columns.T)
    contrasts = multivariate_normal(
        np.zeros(38), basis.T @ covariance_at(data, POINT) @ basis
    ).logpdf(basis.T @ data.power_db)
    constant = -0.5 * np.linalg.slogdet(data.columns.T @ data.columns)[1]
    assert evaluate(data, POINT).log_likelihood == pytest.approx(contrasts + constant)


def test_mean_is_generalised_least_squares():
    """Coefficients and covariance agree with the dense formula."""
    data = data_of(simulated(CHANNEL, 1, 40, 200.0))
    weight = np.linalg.inv(covariance_at(data, POINT))
    covariance = np.linalg.inv(data.columns.T @ weight @ data.columns)
    at = evaluate(data, POINT)
    np.testing.assert_allclose(at.coefficient_covariance, covariance, rtol=1e-8)
    expected = covariance @ data.columns.T @ weight @ data.power_db
    np.testing.assert_allclose(at.coefficients, expected, rtol=1e-8)


@pytest.mark.parametrize("share", [0.0, 0.3])
@pytest.mark.parametrize("both", [True, False])
def test_gradient_is_the_slope(share, both):
    """Analytic and central-difference gradients agree, with and without censoring."""
    data = data_of(simulated(CHANNEL, 2, 60, 200.0, share), both)
    gradient = evaluate(data, POINT).gradient
    for i in range(3):
        step = np.zeros(3)
        step[i] = 1e-4 * POINT[i]
        up, down = (evaluate(data, tuple(POINT + s * step)).log_likelihood for s in (1, -1))
        assert gradient[i] == pytest.approx((up - down) / (2 * step[i]), rel=2e-4, abs=1e-6)


def test_one_limit_has_its_exact_probability():
    """With a single censored value the likelihood is exact: density times normal probability."""
    measurements = simulated(CHANNEL, 3, 30, 200.0)
    flags = np.zeros(30, bool)
    flags[7] = True
    censored = type(measurements)(measurements.positions_m, measurements.power_dbm, flags)
    limit = measurements.power_dbm[7]
    # P(y7 <= limit | rest) by integrating the joint restricted density over y7.
    grid = np.linspace(limit - 60.0, limit, 1201)
    joint = []
    for value in grid:
        power = measurements.power_dbm.copy()
        power[7] = value
        whole = type(measurements)(measurements.positions_m, power, np.zeros(30, bool))
        joint.append(evaluate(data_of(whole), POINT).log_likelihood)
    mass = np.log(np.trapezoid(np.exp(np.array(joint) - max(joint)), grid)) + max(joint)
    assert evaluate(data_of(censored), POINT).log_likelihood == pytest.approx(mass, abs=1e-4)


@pytest.mark.parametrize("share", [0.0, 0.3])
@pytest.mark.parametrize("rows", [slice(0, 0), slice(0, 60, 3), slice(0, 60)])
@pytest.mark.parametrize("step", [1.0, 8.0])
def test_gradient_of_rounded_powers_is_the_slope(share, rows, step):
    """Central differences agree where none, some or all are intervals, beside limits."""
    data = intervals_of(rounded(simulated(CHANNEL, 2, 60, 200.0, share), step), rows)
    gradient = evaluate(data, POINT).gradient
    for i in range(3):
        move = np.zeros(3)
        move[i] = 1e-3 * POINT[i]
        up, down = (evaluate(data, tuple(POINT + s * move)).log_likelihood for s in (1, -1))
        assert gradient[i] == pytest.approx((up - down) / (2 * move[i]), rel=2e-4, abs=3e-6)


def test_fine_steps_are_gaussian():
    """Outside the intervals rounding adds r^2 / 12 to the diagonal: the density of contrasts."""
    measurements = simulated(CHANNEL, 0, 40, 200.0)
    resolution = np.repeat([0.0, 1.0, 3.0, 0.5], 10)
    data = data_of(replace(measurements, resolution_db=resolution))
    basis = null_space(data.columns.T)
    total = covariance_at(data, POINT) + np.diag(resolution**2 / 12.0)
    contrasts = multivariate_normal(np.zeros(38), basis.T @ total @ basis).logpdf(
        basis.T @ data.power_db
    )
    constant = -0.5 * np.linalg.slogdet(data.columns.T @ data.columns)[1]
    assert evaluate(data, POINT).log_likelihood == pytest.approx(contrasts + constant)


@pytest.mark.parametrize("step", [0.1, 2.0, 9.0])
def test_one_interval_has_its_exact_probability(step):
    """With a single interval the likelihood is the density integrated over it, by its length."""
    measurements = simulated(CHANNEL, 3, 30, 200.0)
    resolution = np.where(np.arange(30) == 7, step, 0.0)
    data = intervals_of(replace(measurements, resolution_db=resolution), [7])
    middle = measurements.power_dbm[7]
    nodes, weights = np.polynomial.legendre.leggauss(24)
    logs = []
    for value in middle + 0.5 * step * nodes:
        power = measurements.power_dbm.copy()
        power[7] = value
        whole = replace(measurements, power_dbm=power)
        logs.append(evaluate(data_of(whole), POINT).log_likelihood)
    logs = np.array(logs)
    mean = np.log(0.5 * weights @ np.exp(logs - logs.max())) + logs.max()
    assert evaluate(data, POINT).log_likelihood == pytest.approx(mean, abs=1e-7)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_narrow_intervals_are_exact_measurements(share):
    """All as intervals, none Gaussian: for r -> 0 value, gradient and mean are the exact ones."""
    measurements = simulated(CHANNEL, 6, 40, 200.0, share)
    exact = evaluate(data_of(measurements), POINT)
    resolution = np.where(measurements.censored, 0.0, 1e-4)
    narrow = replace(measurements, resolution_db=resolution)
    found = evaluate(intervals_of(narrow, slice(0, 40)), POINT)
    assert found.log_likelihood == pytest.approx(exact.log_likelihood, abs=1e-5)
    np.testing.assert_allclose(found.gradient, exact.gradient, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found.coefficients, exact.coefficients, rtol=1e-5)
    np.testing.assert_allclose(
        found.coefficient_covariance, exact.coefficient_covariance, rtol=1e-4
    )


def test_both_ways_agree_where_the_rule_switches():
    """At r = 2 omega Sheppard's Gaussian and intervals differ little, in value and slope."""
    measurements = rounded(simulated(CHANNEL, 7, 200, 200.0), 4.0)
    point = (36.0, 4.0, 30.0)
    fine = evaluate(data_of(measurements), point)
    coarse = evaluate(intervals_of(measurements, slice(0, 200)), point)
    assert fine.log_likelihood == pytest.approx(coarse.log_likelihood, abs=0.1)
    spread = np.sqrt(np.diag(expected_information(data_of(measurements), point, fine)))
    assert np.abs((fine.gradient - coarse.gradient) / spread).max() < 0.1


def test_information_is_the_spread_of_the_score():
    """Over simulated data the covariance of the gradient is the expected information."""
    positions = simulated(CHANNEL, 4, 30, 150.0)
    data = data_of(positions)
    root = np.linalg.cholesky(covariance_at(data, POINT))
    rng = np.random.default_rng(0)
    scores = []
    for _ in range(1500):
        power = data.columns @ [-40.0, 3.0] + root @ rng.standard_normal(30)
        drawn = replace(data, power_db=power)
        scores.append(evaluate(drawn, POINT).gradient)
    scores = np.array(scores)
    information = expected_information(data, POINT, evaluate(data, POINT))
    scale = np.sqrt(np.outer(np.diag(information), np.diag(information)))
    np.testing.assert_allclose(np.cov(scores.T) / scale, information / scale, atol=0.12)
    assert np.abs(scores.mean(axis=0) / np.sqrt(np.diag(information))).max() < 0.1


def test_profiling_is_the_maximum_over_scale():
    """The profiled value differs from the best over scales by nothing but the stated constant."""
    data = data_of(simulated(CHANNEL, 5, 40, 200.0))
    for share, beta in ((0.3, 10.0), (0.9, 40.0)):
        value, total = profiled_log_likelihood(data, share, beta)
        scales = total * np.array([0.97, 1.0, 1.03])
        direct = [evaluate(data, (share * s, (1 - share) * s, beta)).log_likelihood for s in scales]
        assert np.argmax(direct) == 1
        assert value == pytest.approx(direct[1], abs=1e-8)


@pytest.mark.parametrize("censored", [0.0, 0.2])
def test_gradient_with_ages_receivers_and_errors_of_position(censored):
    """Their covariances are in the value, and its slope is the gradient still."""
    measurements = varied(50, 20, censored=censored)
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, DRIFTING.station, True)
    data = likelihood_data(model, measurements, DRIFTING)
    gradient = evaluate(data, POINT).gradient
    for i in range(3):
        step = np.zeros(3)
        step[i] = 1e-4 * POINT[i]
        up, down = (evaluate(data, tuple(POINT + s * step)).log_likelihood for s in (1, -1))
        assert gradient[i] == pytest.approx((up - down) / (2 * step[i]), rel=2e-4, abs=1e-6)


def test_ages_receivers_and_errors_of_position_are_in_the_density():
    """Exact measurements: the density of contrasts under the covariance written out."""
    measurements = varied(40, 21)
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, DRIFTING.station, True)
    data = likelihood_data(model, measurements, DRIFTING)
    channel = replace(
        DRIFTING, shadow_std_db=np.sqrt(POINT[0]), decorrelation_m=POINT[2], n_pl=DRIFTING.n_pl
    )
    total = dense_covariance(channel, measurements)
    total += np.diag(POINT[1] + measured_path_loss_variance_db2(measurements, DRIFTING))
    basis = null_space(model.columns.T)
    contrasts = multivariate_normal(np.zeros(38), basis.T @ total @ basis).logpdf(
        basis.T @ measurements.power_dbm
    )
    constant = -0.5 * np.linalg.slogdet(model.columns.T @ model.columns)[1]
    assert evaluate(data, POINT).log_likelihood == pytest.approx(contrasts + constant)


def test_profiling_frees_the_offsets():
    """Starts see the same data whatever constant a receiver adds, also where one is missing."""
    measurements = varied(40, 22, errors=False)
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, DRIFTING.station, True)
    moved = replace(
        measurements, power_dbm=measurements.power_dbm + 50.0 * (measurements.receiver == 2)
    )
    values = [
        profiled_log_likelihood(likelihood_data(model, given, DRIFTING), 0.7, 10.0)
        for given in (measurements, moved)
    ]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-8)
    alone = replace(measurements, receiver=np.full(40, 3))
    assert likelihood_data(model, alone, DRIFTING).flat_columns().shape == (40, 2)
    few = measurements.take(slice(6))
    model = mean_model(few.positions_m, ~few.censored, DRIFTING.station, True)
    assert likelihood_data(model, few, DRIFTING).flat_columns().shape == (6, 2)
