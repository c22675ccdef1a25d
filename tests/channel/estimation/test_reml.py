"""Restricted maximum likelihood against brute force and known channels."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Station
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.estimation.channel_fit import covariance_bounds
from planopt.channel.estimation.least_squares import examine
from planopt.channel.estimation.likelihood import RestrictedLikelihood, likelihood_data
from planopt.channel.estimation.reml import SAMPLED_ROWS, minimise_damped, reml_fit
from planopt.channel.parameters import mean_model

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))


@one_blas_thread()
def fitted(measurements, variance=40.0):
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, CHANNEL.station, True)
    limits = examine(measurements, CHANNEL.station).decorrelation_bounds_m
    bounds = covariance_bounds(variance, limits)
    return model, bounds, reml_fit(model, measurements, bounds, CHANNEL)


@pytest.mark.parametrize(("count", "share"), [(60, 0.0), (60, 0.3), (SAMPLED_ROWS + 20, 0.2)])
def test_nothing_on_a_grid_is_more_likely(count, share):
    """No point of a dense grid within the bounds beats the optimum, sampled start or not."""
    measurements = simulated(CHANNEL, 1, count, 300.0, share)
    model, bounds, found = fitted(measurements)
    data = likelihood_data(model, measurements, CHANNEL)
    side = 7 if count < 100 else 3
    grids = [
        np.geomspace(*limits, side)
        for limits in (bounds.shadow_db2, bounds.multipath_db2, bounds.decorrelation_m)
    ]
    values = [
        RestrictedLikelihood(data).at((xi2, om2, beta)).log_likelihood
        for xi2 in grids[0]
        for om2 in grids[1]
        for beta in grids[2]
    ]
    assert found.best.at.log_likelihood >= max(values) - 1e-6
    estimate = found.covariance
    at = RestrictedLikelihood(data).at(
        (estimate.shadow_variance_db2, estimate.multipath_variance_db2, estimate.decorrelation_m)
    )
    assert at.log_likelihood == pytest.approx(found.best.at.log_likelihood, abs=1e-6)
    np.testing.assert_allclose(at.coefficients, found.best.at.coefficients, rtol=1e-5)


def test_scaling_units():
    """Powers twice as wide double xi and omega; lengths twice as long double beta."""
    measurements = simulated(CHANNEL, 2, 120, 300.0)
    _, _, found = fitted(measurements)
    wide = type(measurements)(
        measurements.positions_m, 2.0 * measurements.power_dbm, measurements.censored
    )
    _, _, twice = fitted(wide, 160.0)
    assert twice.covariance.shadow_variance_db2 == pytest.approx(
        4.0 * found.covariance.shadow_variance_db2, rel=1e-2
    )
    assert twice.covariance.decorrelation_m == pytest.approx(
        found.covariance.decorrelation_m, rel=1e-2
    )


def test_a_parameter_at_its_bound_is_named_and_its_error_unknown():
    """Pure noise has no shadowing to find; the other errors stay finite."""
    quiet = ChannelParameters(-40.0, 3.0, 1e-4, 30.0, 4.0, CHANNEL.station)
    fits = [fitted(simulated(quiet, seed, 60, 300.0), 16.0)[2].covariance for seed in range(6)]
    at_bound = [fit for fit in fits if fit.warnings]
    assert at_bound
    for fit in at_bound:
        names = [text.split()[0] for text in fit.warnings]
        parameters = ("shadow_std_db", "multipath_std_db", "decorrelation_m")
        for name, error in zip(parameters, fit.standard_errors, strict=True):
            assert (error == math.inf) == (name in names)


def test_standard_errors_are_the_spread_over_channels():
    """Estimates of omega scatter over simulated channels as their standard error says."""
    fits = [fitted(simulated(CHANNEL, seed, 150, 200.0))[2] for seed in range(40)]
    omegas = [math.sqrt(fit.covariance.multipath_variance_db2) for fit in fits]
    errors = [fit.covariance.standard_errors[1] for fit in fits]
    assert np.std(omegas) == pytest.approx(np.median(errors), rel=0.35)
    z = [
        (fit.best.at.coefficients[1] - CHANNEL.n_pl)
        / math.sqrt(fit.best.at.coefficient_covariance[1, 1])
        for fit in fits
    ]
    assert 0.7 < np.std(z) < 1.4


TARGET = np.array([1.0, -2.0, 0.5])
CURVATURE = np.array([[4.0, 1.9, 0.0], [1.9, 1.0, 0.1], [0.0, 0.1, 9.0]])
WIDE = np.full(3, 10.0)


def quadratic(x):
    offset = x - TARGET
    return 0.5 * offset @ CURVATURE @ offset, CURVATURE @ offset, CURVATURE


def counted(objective):
    """The objective and a list of the points it was evaluated at."""
    points = []

    def counting(x):
        points.append(x.copy())
        return objective(x)

    return counting, points


def test_damped_minimum():
    """A quadratic takes few evaluations from outside the box, and a minimum takes one."""
    objective, points = counted(quadratic)
    value, point = minimise_damped(objective, np.full(3, 20.0), -WIDE, WIDE, 1e-12)
    np.testing.assert_allclose(point, TARGET, atol=1e-5)
    assert value < 1e-11
    assert len(points) < 20
    assert all((np.abs(p) <= 10.0).all() for p in points)
    for objective, start in (
        (quadratic, TARGET),
        (lambda x: (float(x.sum()), np.ones(3), np.eye(3)), -WIDE),
        (lambda x: (0.0, np.zeros(3), np.zeros((3, 3))), np.zeros(3)),
    ):
        counting, points = counted(objective)
        _, point = minimise_damped(counting, start, -WIDE, WIDE, 1e-9)
        np.testing.assert_array_equal(point, start)
        assert len(points) == 1


@pytest.mark.parametrize("seed", range(8))
def test_minimum_on_the_boundary(seed):
    """In random boxes, corners and faces included, it ends where L-BFGS-B does."""
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-4.0, 1.0, 3)
    upper = lower + rng.uniform(0.1, 3.0, 3)
    expected = minimize(
        lambda x: quadratic(x)[:2],
        lower,
        jac=True,
        bounds=list(zip(lower, upper, strict=True)),
        options={"ftol": 1e-15, "gtol": 1e-10},
    )
    value, point = minimise_damped(quadratic, rng.uniform(lower, upper), lower, upper, 1e-12)
    assert value == pytest.approx(expected.fun, abs=1e-7)
    np.testing.assert_allclose(point, expected.x, atol=1e-3)
    assert ((lower <= point) & (point <= upper)).all()
