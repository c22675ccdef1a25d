"""The line of equation 2.3 in closed form."""

import math

import numpy as np
import pytest

from planopt.channel.estimation.channel_fit import covariance_bounds
from planopt.channel.estimation.lemma1 import (
    EmpiricalCorrelation,
    LogBins,
    capped_bins,
    enough,
    lemma1_fit,
    log_line,
    printed_bins,
)

BOUNDS = covariance_bounds(20.0, (1.0, 100.0))
LAGS = np.linspace(1.0, 90.0, 30)


def test_recovers_an_exact_exponential():
    """Without noise xi, beta and omega come back, whatever the weights."""
    r = 16.0 * np.exp(-LAGS / 12.0)
    weight = np.random.default_rng(0).uniform(1, 9, 30)
    found = lemma1_fit(LogBins(LAGS, np.log(r), weight), 20.0, 100, BOUNDS)
    assert found.shadow_variance_db2 == pytest.approx(16.0)
    assert found.decorrelation_m == pytest.approx(12.0)
    assert found.multipath_variance_db2 == pytest.approx(4.0)
    assert found.warnings == ()


def test_line_and_errors_equal_weighted_regression():
    """Slope, intercept and errors agree with NumPy's polynomial fit."""
    rng = np.random.default_rng(1)
    log_r = 2.5 - LAGS / 12.0 + 0.3 * rng.standard_normal(30)
    line = log_line(LogBins(LAGS, log_r, np.ones(30)))
    (slope, intercept), covariance = np.polyfit(LAGS, log_r, 1, cov=True)
    assert (line.intercept, line.rate_per_m) == pytest.approx((intercept, -slope))
    errors = math.exp(intercept) * math.sqrt(covariance[1, 1]), math.sqrt(covariance[0, 0])
    assert line.errors == pytest.approx(errors, rel=1e-6)
    weight = rng.uniform(1, 9, 30)
    weighted = log_line(LogBins(LAGS, log_r, weight))
    slope, intercept = np.polyfit(LAGS, log_r, 1, w=np.sqrt(weight))
    assert (weighted.intercept, weighted.rate_per_m) == pytest.approx((intercept, -slope))


def test_two_bins_fix_the_line_but_not_its_error():
    """With two bins the scatter, hence the error, is unknown."""
    line = log_line(LogBins(np.array([1.0, 3.0]), np.array([2.0, 1.0]), np.ones(2)))
    assert (line.intercept, line.rate_per_m) == pytest.approx((2.5, 0.5))
    assert line.errors == (math.inf, math.inf)


def test_the_printed_set_and_its_repair():
    """L keeps 0 < r < alpha at all lags; the cap drops long ones and weights by n r^2."""
    r = np.array([25.0, 10.0, -1.0, 5.0, 0.5])
    lag, pairs = np.array([1.0, 2, 3, 20, 60]), np.array([4.0, 5, 6, 7, 8])
    correlation = EmpiricalCorrelation(lag, r, pairs)
    printed = printed_bins(correlation, 20.0)
    np.testing.assert_array_equal(printed.lag_m, [2, 20, 60])
    np.testing.assert_array_equal(printed.weight, [5, 7, 8])
    capped = capped_bins(correlation, 20.0, 100.0)
    np.testing.assert_array_equal(capped.lag_m, [2, 20])
    assert capped.weight[1] / capped.weight[0] == pytest.approx(7 * 25.0 / (5 * 100.0))


def test_one_lag_is_not_enough():
    """A line needs two different lags."""
    assert not enough(LogBins(np.array([1.0]), np.array([1.0]), np.array([1.0])))
    assert not enough(LogBins(np.zeros(0), np.zeros(0), np.zeros(0)))
    assert enough(LogBins(np.array([1.0, 2.0]), np.ones(2), np.ones(2)))
