"""The exponential in the linear domain."""

import math

import numpy as np
import pytest
from scipy.optimize import curve_fit

from planopt.channel.estimation.channel_fit import covariance_bounds
from planopt.channel.estimation.correlation_solvers import nls_fit
from planopt.channel.estimation.lemma1 import EmpiricalCorrelation

LAGS = np.linspace(0.5, 80.0, 60)
PAIRS = np.random.default_rng(0).uniform(10.0, 90.0, 60)
BOUNDS = covariance_bounds(20.0, (0.5, 100.0))


def test_equals_scipy_on_noisy_bins():
    """Estimate and errors agree with SciPy's weighted curve fit, negative bins included."""
    r = 16.0 * np.exp(-LAGS / 12.0) + np.random.default_rng(1).standard_normal(60)
    assert (r < 0).any()
    found = nls_fit(EmpiricalCorrelation(LAGS, r, PAIRS), 20.0, 90, BOUNDS)
    best, covariance = curve_fit(
        lambda d, xi2, rate: xi2 * np.exp(-rate * d), LAGS, r, (10.0, 0.1), PAIRS**-0.5
    )
    assert found.shadow_variance_db2 == pytest.approx(best[0], rel=1e-5)
    assert 1.0 / found.decorrelation_m == pytest.approx(best[1], rel=1e-5)
    xi_error = math.sqrt(covariance[0, 0]) / (2.0 * math.sqrt(best[0]))
    assert found.standard_errors[0] == pytest.approx(xi_error, rel=1e-4)


def test_no_selection_bias_where_lemma_1_has_one():
    """Averaged over noise, pure exponentials come back; no bin is dropped for its sign."""
    rng = np.random.default_rng(2)
    shadows = []
    for _ in range(30):
        r = 4.0 * np.exp(-LAGS / 10.0) + rng.standard_normal(60)
        fit = nls_fit(EmpiricalCorrelation(LAGS, r, PAIRS), 20.0, 90, BOUNDS)
        shadows.append(fit.shadow_variance_db2)
    assert np.mean(shadows) == pytest.approx(4.0, abs=0.5)


def test_no_correlation_and_too_few_bins():
    """Nothing positive puts xi at its bound; one bin leaves errors unknown."""
    none = nls_fit(EmpiricalCorrelation(LAGS, -np.ones(60), PAIRS), 20.0, 90, BOUNDS)
    assert any("xi is at a bound" in text for text in none.warnings)
    one = nls_fit(EmpiricalCorrelation(LAGS[:1], np.ones(1), PAIRS[:1]), 20.0, 90, BOUNDS)
    assert one.standard_errors[2] == math.inf
