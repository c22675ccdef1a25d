"""Theta from products of whitened columns against least squares of the columns themselves."""

import numpy as np

from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import WEAK_THETA_DEVIATION, theta_estimate

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def products(gamma, values):
    """Of [y - Gamma theta_0, Gamma]."""
    columns = np.column_stack([values - gamma @ [-40.0, 3.0], gamma])
    return columns.T @ columns


def test_least_squares_where_theta_is_identified():
    """No prior: theta by lstsq, its covariance (Gamma' Gamma)^-1."""
    generator = np.random.default_rng(0)
    gamma = np.column_stack([np.ones(20), generator.uniform(-25.0, -10.0, 20)])
    values = generator.normal(-90.0, 6.0, 20)
    theta, covariance = theta_estimate(PARAMETERS, products(gamma, values))
    np.testing.assert_allclose(theta, np.linalg.lstsq(gamma, values, rcond=None)[0], rtol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(gamma.T @ gamma), rtol=1e-9)


def test_prior_where_it_is_not():
    """One distance only: the posterior of the weak prior about the parameters' theta."""
    gamma = np.array([[1.0, -20.0]])
    theta, covariance = theta_estimate(PARAMETERS, products(gamma, np.array([-90.0])))
    prior = np.diag(np.square(WEAK_THETA_DEVIATION))
    expected = np.linalg.inv(np.linalg.inv(prior) + gamma.T @ gamma)
    np.testing.assert_allclose(covariance, expected, rtol=1e-9)
    moved = expected @ gamma[0] * (-90.0 - gamma[0] @ [-40.0, 3.0])
    np.testing.assert_allclose(theta, [-40.0, 3.0] + moved, rtol=1e-9)
