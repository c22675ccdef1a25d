"""Fits to the empirical correlation: direct sums, closed forms and other solvers."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import curve_fit, linprog, minimize

from planopt.channel.estimation.channel_fit import covariance_bounds
from planopt.channel.estimation.correlation_fit import (
    BINS,
    HUBER_DEVIATIONS,
    NORMAL_MEDIAN,
    EmpiricalCorrelation,
    LogBins,
    convex_fit,
    empirical_correlation,
    lemma1_fit,
    log_bins,
    nls_fit,
)


def test_correlation_is_a_sum_over_pairs():
    """As a double loop has it; no pair is lost between blocks, the largest lag included."""
    rng = np.random.default_rng(0)
    positions, residual = rng.uniform(0, 10, (40, 2)), rng.standard_normal(40)
    extent = float(np.hypot(*np.ptp(positions, axis=0)))
    found = empirical_correlation(positions, residual, extent)
    sums = {}
    for i in range(40):
        for j in range(i):
            lag = np.hypot(*(positions[i] - positions[j]))
            sums.setdefault(int(lag / (extent / BINS)), []).append((lag, residual[i] * residual[j]))
    expected = np.array([np.mean(sums[k], axis=0) for k in sorted(sums)])
    np.testing.assert_allclose(found.lag_m, expected[:, 0])
    np.testing.assert_allclose(found.covariance_db2, expected[:, 1])
    np.testing.assert_array_equal(found.pairs, [len(sums[k]) for k in sorted(sums)])
    positions = np.random.default_rng(1).uniform(0, 1, (1200, 2))
    positions[:2] = [[0, 0], [1, 1]]
    found = empirical_correlation(positions, np.ones(1200), np.sqrt(2.0))
    assert found.pairs.sum() == 1200 * 1199 / 2
    np.testing.assert_allclose(found.covariance_db2, 1.0)
    assert found.lag_m[-1] == pytest.approx(np.sqrt(2.0), rel=0.02)


FREE = covariance_bounds(30.0, (1.0, 100.0))
LAGS = np.linspace(1.0, 40.0, 25)
RNG = np.random.default_rng(3)
SCATTER = 0.3 * RNG.standard_normal(25)
WEIGHT = RNG.uniform(1.0, 9.0, 25)


def test_lemma1_is_weighted_regression():
    """Estimates are those of NumPy's polynomial fit, and with equal weights so are the errors."""
    logs = np.log(16.0) - LAGS / 12.0 + SCATTER
    for weight in (np.ones(25), WEIGHT):
        found = lemma1_fit(LogBins(LAGS, logs, weight), 30.0, 100, FREE)
        (slope, intercept), covariance = np.polyfit(LAGS, logs, 1, w=np.sqrt(weight), cov=True)
        assert found.warnings == ()
        assert found.shadow_variance_db2 == pytest.approx(math.exp(intercept))
        assert found.decorrelation_m == pytest.approx(-1.0 / slope)
        assert found.multipath_variance_db2 == pytest.approx(30.0 - math.exp(intercept))
        if weight is not WEIGHT:
            xi, _, beta = found.standard_errors
            assert xi == pytest.approx(math.exp(0.5 * intercept) * covariance[1, 1] ** 0.5 / 2)
            assert beta == pytest.approx(covariance[0, 0] ** 0.5 / slope**2)


def test_two_bins_fix_the_line_but_not_its_error():
    """With two bins the scatter, hence the error, is unknown."""
    found = lemma1_fit(LogBins(np.array([1.0, 3.0]), np.array([2.0, 1.0]), np.ones(2)), 30, 9, FREE)
    assert found.shadow_variance_db2 == pytest.approx(math.exp(2.5))
    assert found.decorrelation_m == pytest.approx(2.0)
    assert found.standard_errors == (math.inf, math.inf, math.inf)


def test_the_printed_set_and_its_repair():
    """L keeps 0 < r < alpha at all lags; the cap drops long ones and weights by n r^2."""
    r = np.array([25.0, 10.0, -1.0, 5.0, 0.5])
    lag, pairs = np.array([1.0, 2, 3, 20, 60]), np.array([4.0, 5, 6, 7, 8])
    correlation = EmpiricalCorrelation(lag, r, pairs)
    printed = log_bins(correlation, 20.0)
    np.testing.assert_array_equal(printed.lag_m, [2, 20, 60])
    np.testing.assert_array_equal(printed.weight, [5, 7, 8])
    capped = log_bins(correlation, 20.0, 100.0)
    np.testing.assert_array_equal(capped.lag_m, [2, 20])
    assert capped.weight[1] / capped.weight[0] == pytest.approx(7 * 25.0 / (5 * 100.0))


def bins(xi2, beta):
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
        (bins(60.0, 12.0), 30.0, (1.0, 100.0), "multipath_std_db"),
        (bins(16.0, 500.0), 30.0, (1.0, 100.0), "decorrelation_m"),
        (bins(16.0, 12.0), 30.0, (20.0, 100.0), "decorrelation_m"),
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


NLS_LAGS = np.linspace(0.5, 80.0, 60)
PAIRS = np.random.default_rng(0).uniform(10.0, 90.0, 60)
NLS_BOUNDS = covariance_bounds(20.0, (0.5, 100.0))


def test_nls_equals_curve_fit_on_noisy_bins():
    """Estimate and errors agree with SciPy's weighted curve fit, negative bins included."""
    r = 16.0 * np.exp(-NLS_LAGS / 12.0) + np.random.default_rng(1).standard_normal(60)
    assert (r < 0).any()
    found = nls_fit(EmpiricalCorrelation(NLS_LAGS, r, PAIRS), 20.0, 90, NLS_BOUNDS)
    best, covariance = curve_fit(
        lambda d, xi2, rate: xi2 * np.exp(-rate * d), NLS_LAGS, r, (10.0, 0.1), PAIRS**-0.5
    )
    assert found.shadow_variance_db2 == pytest.approx(best[0], rel=1e-5)
    assert 1.0 / found.decorrelation_m == pytest.approx(best[1], rel=1e-5)
    xi_error = math.sqrt(covariance[0, 0]) / (2.0 * math.sqrt(best[0]))
    assert found.standard_errors[0] == pytest.approx(xi_error, rel=1e-4)


def test_no_correlation_and_too_few_bins():
    """Nothing positive puts xi at its bound; one bin leaves errors unknown."""
    none = nls_fit(EmpiricalCorrelation(NLS_LAGS, -np.ones(60), PAIRS), 20.0, 90, NLS_BOUNDS)
    assert any("shadow_std_db is at a bound" in text for text in none.warnings)
    one = nls_fit(EmpiricalCorrelation(NLS_LAGS[:1], np.ones(1), PAIRS[:1]), 20.0, 90, NLS_BOUNDS)
    assert one.standard_errors[2] == math.inf
