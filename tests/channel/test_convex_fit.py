"""The convex programme against the closed form and against its own optimality."""

import numpy as np
import pytest
from scipy.optimize import minimize

from planopt.channel.convex_fit import convex_fit
from planopt.channel.covariance_fit import covariance_bounds
from planopt.channel.lemma1 import LogBins, lemma1_fit

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
