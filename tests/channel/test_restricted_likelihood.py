"""The restricted likelihood and its gradient."""

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.stats import multivariate_normal
from simulated_channel import simulated

from planopt.channel.mean_model import mean_model
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.restricted_likelihood import (
    evaluate,
    expected_information,
    likelihood_data,
    profiled_log_likelihood,
)

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))
POINT = (30.0, 5.0, 25.0)


def data_of(measurements, both=True):
    """Likelihood data with the full or the one-column mean."""
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, CHANNEL.station, both)
    return likelihood_data(model, measurements)


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


def test_information_is_the_spread_of_the_score():
    """Over simulated data the covariance of the gradient is the expected information."""
    positions = simulated(CHANNEL, 4, 30, 150.0)
    data = data_of(positions)
    root = np.linalg.cholesky(covariance_at(data, POINT))
    rng = np.random.default_rng(0)
    scores = []
    for _ in range(1500):
        power = data.columns @ [-40.0, 3.0] + root @ rng.standard_normal(30)
        drawn = type(data)(data.distance_m, data.columns, power, 30)
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
