"""The convex programme against the closed form, other solvers and its own optimality."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import linprog, minimize
from simulated_channel import simulated

from planopt import InputError
from planopt.channel import ChannelParameters, Station, fit_channel
from planopt.channel.estimation.channel_fit import covariance_bounds
from planopt.channel.estimation.correlation_solvers import (
    HUBER_DEVIATIONS,
    NORMAL_MEDIAN,
    convex_fit,
)
from planopt.channel.estimation.lemma1 import LogBins, lemma1_fit

LAGS = np.linspace(1.0, 40.0, 25)
RNG = np.random.default_rng(3)
SCATTER = 0.3 * RNG.standard_normal(25)
WEIGHT = RNG.uniform(1.0, 9.0, 25)


def bins(xi2, beta):
    """Noisy log correlations of a channel."""
    return LogBins(LAGS, np.log(xi2) - LAGS / beta + SCATTER, WEIGHT)


def test_equals_the_closed_form_when_nothing_binds():
    """Inside the constraints both give the same estimate and errors."""
    bounds = covariance_bounds(30.0, (1.0, 100.0))
    closed = lemma1_fit(bins(16.0, 12.0), 30.0, 80, bounds)
    convex = convex_fit(bins(16.0, 12.0), 30.0, 80, bounds)
    assert closed.warnings == convex.warnings == ()
    assert convex.shadow_variance_db2 == pytest.approx(closed.shadow_variance_db2, rel=1e-6)
    assert convex.decorrelation_m == pytest.approx(closed.decorrelation_m, rel=1e-6)
    assert convex.standard_errors == pytest.approx(closed.standard_errors, rel=1e-5)


@pytest.mark.parametrize(
    ("data", "alpha", "beta_bounds", "words"),
    [
        (bins(60.0, 12.0), 30.0, (1.0, 100.0), "omega"),
        (bins(16.0, 500.0), 30.0, (1.0, 100.0), "beta"),
        (bins(16.0, 12.0), 30.0, (20.0, 100.0), "beta"),
    ],
)
def test_is_the_constrained_optimum_when_one_binds(data, alpha, beta_bounds, words):
    """With xi^2 or beta at its constraint the other is refitted, and the warning says which."""
    bounds = covariance_bounds(alpha, beta_bounds)
    found = convex_fit(data, alpha, 80, bounds)
    box = [
        (np.log(bounds.shadow_db2[0]), np.log(alpha - bounds.multipath_db2[0])),
        (1.0 / beta_bounds[1], 1.0 / beta_bounds[0]),
    ]

    def loss(x):
        return (WEIGHT * (data.log_covariance - x[0] + x[1] * LAGS) ** 2).sum()

    best = minimize(loss, [1.0, 0.03], bounds=box, options={"ftol": 1e-15, "gtol": 1e-10})
    assert np.log(found.shadow_variance_db2) == pytest.approx(best.x[0], abs=1e-4)
    assert 1.0 / found.decorrelation_m == pytest.approx(best.x[1], abs=1e-5)
    assert len(found.warnings) == 1
    assert found.warnings[0].startswith(words)


FREE = covariance_bounds(30.0, (1.0, 100.0))
DESIGN = np.column_stack([np.ones(25), -LAGS])


def weighed(data):
    """The same bins, `WEIGHT` as their numbers of pairs n, weighed by n r^2."""
    r = np.exp(data.log_covariance)
    return dataclasses.replace(data, weight=WEIGHT * r**2)


def least_absolute(logs, root, box):
    """(log xi^2, 1 / beta) of least sum root |scatter|, by linear programming."""
    rows = root[:, None] * DESIGN
    found = linprog(
        np.concatenate([np.zeros(2), np.ones(25)]),
        np.block([[rows, -np.eye(25)], [-rows, -np.eye(25)]]),
        np.concatenate([root * logs, -root * logs]),
        bounds=[*box, *[(0.0, None)] * 25],
    )
    return found.x[:2]


def weighed_by_line(logs, box):
    """Square roots of weights n r^2, r from the line of least absolute values of weights n."""
    pairs = np.sqrt(WEIGHT)
    root = pairs * np.exp(DESIGN @ least_absolute(logs, pairs, box))
    return root / np.linalg.norm(root)


@pytest.mark.parametrize(
    ("data", "beta_bounds"), [(bins(16.0, 12.0), (1.0, 100.0)), (bins(16.0, 500.0), (1.0, 40.0))]
)
def test_absolute_values_by_linear_programming(data, beta_bounds):
    """The same optimum as a linear programme's, with and without a constraint that binds."""
    bounds = covariance_bounds(30.0, beta_bounds)
    box = [
        (np.log(bounds.shadow_db2[0]), np.log(30.0 - bounds.multipath_db2[0])),
        (1.0 / beta_bounds[1], 1.0 / beta_bounds[0]),
    ]
    logs = data.log_covariance
    intercept, rate = least_absolute(logs, weighed_by_line(logs, box), box)
    found = convex_fit(weighed(data), 30.0, 80, bounds, "absolute")
    assert np.log(found.shadow_variance_db2) == pytest.approx(intercept, abs=1e-6)
    assert 1.0 / found.decorrelation_m == pytest.approx(rate, abs=1e-7)


def test_huber_by_reweighted_least_squares():
    """The same optimum as iteratively reweighted least squares at the same turn."""
    data = bins(16.0, 12.0)
    logs, free = data.log_covariance, [(None, None)] * 2
    root = weighed_by_line(logs, free)
    line = least_absolute(logs, root, free)
    absolute = np.sort(np.abs(root * (logs - DESIGN @ line)))
    turn = HUBER_DEVIATIONS * np.median(absolute[2:]) / NORMAL_MEDIAN
    for _ in range(500):
        scatter = np.abs(root * (logs - DESIGN @ line))
        weight = root * np.sqrt(np.minimum(1.0, turn / np.maximum(scatter, 1e-300)))
        line = np.linalg.lstsq(weight[:, None] * DESIGN, weight * logs)[0]
    found = convex_fit(weighed(data), 30.0, 80, FREE, "huber")
    assert np.log(found.shadow_variance_db2) == pytest.approx(line[0], abs=1e-6)
    assert 1.0 / found.decorrelation_m == pytest.approx(line[1], abs=1e-7)


def test_outlying_measurements_hurt_squares_alone():
    """Two spots 60 m apart where all is 12 dB too strong pull squares' beta to hundreds of m."""
    channel = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))
    spots = np.repeat([[200.0, 100.0], [260.0, 100.0]], 8, axis=0)
    estimates = {"squares": [], "huber": []}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        uniform = rng.uniform(0.0, 300.0, (134, 2))
        positions = np.concatenate([spots + rng.uniform(-1.0, 1.0, (16, 2)), uniform])
        measurements = simulated(channel, seed, 150, 300.0, positions=positions)
        power = measurements.power_dbm + 12.0 * (np.arange(150) < 16)
        wrong = dataclasses.replace(measurements, power_dbm=power)
        for loss, found in estimates.items():
            fit = fit_channel(wrong, channel.station, "convex", loss=loss)
            found.append(fit.parameters.decorrelation_m)
    assert np.median(estimates["squares"]) > 200.0
    assert 20.0 < np.median(estimates["huber"]) < 70.0


@pytest.mark.parametrize("loss", ["huber", "absolute"])
def test_robust_errors_are_the_spread(loss):
    """Over normal scatter the estimates of 1 / beta scatter as the standard errors say."""
    rng = np.random.default_rng(5)
    # Nearly flat, so that all bins weigh alike; unequal weights are counted as fewer bins.
    r = 12.0 * np.exp(-LAGS / 200.0)
    bounds = covariance_bounds(30.0, (1.0, 5000.0))
    rates, errors = [], []
    for _ in range(60):
        logs = np.log(r) + 0.6 / r * rng.standard_normal(25)
        found = convex_fit(LogBins(LAGS, logs, np.exp(2.0 * logs)), 30.0, 80, bounds, loss)
        rates.append(1.0 / found.decorrelation_m)
        errors.append(found.standard_errors[2] / found.decorrelation_m**2)
    assert np.std(rates) == pytest.approx(np.mean(errors), rel=0.35)


def test_losses_that_cannot_be_had():
    """Only convex has a choice, and only of the three."""
    measurements = simulated(
        ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0))), 0, 30, 300.0
    )
    with pytest.raises(InputError, match="no loss"):
        fit_channel(measurements, Station((50.0, 50.0)), "convex", loss="cauchy")
    with pytest.raises(InputError, match="no choice of loss"):
        fit_channel(measurements, Station((50.0, 50.0)), "reml", loss="huber")
