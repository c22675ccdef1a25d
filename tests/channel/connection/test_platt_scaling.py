"""The fit of the calibrated law: against a general optimiser, and on drawn outcomes."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from planopt.channel.connection.connection_law import (
    INTERCEPT_STD,
    LOG_SLOPE_STD,
    NEUTRAL_SLOPE,
    fit_connection_law,
)


def drawn(intercept: float, slope: float, count: int, seed: int = 0):
    """Scores, and outcomes by a logistic law."""
    generator = np.random.default_rng(seed)
    scores = generator.normal(0.5, 2.0, count)
    return scores, generator.uniform(size=count) < expit(intercept + slope * scores)


@pytest.mark.parametrize("seed", range(4))
def test_is_the_mode_that_an_optimiser_finds(seed):
    """Nelder and Mead on the penalised log likelihood, with weights."""
    scores, connected = drawn(-0.8, 1.2, 80, seed)
    weights = np.random.default_rng(seed).uniform(0.2, 2.0, 80)
    found = fit_connection_law(scores, connected, weights)

    def loss(x):
        logit = x[0] + np.exp(x[1]) * scores
        penalty = (x[0] / INTERCEPT_STD) ** 2 + (
            (x[1] - np.log(NEUTRAL_SLOPE)) / LOG_SLOPE_STD
        ) ** 2
        return 0.5 * penalty - weights @ log_expit(np.where(connected, logit, -logit))

    best = minimize(loss, [0.0, 0.5], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    assert (found.intercept, np.log(found.slope)) == pytest.approx(tuple(best.x), abs=1e-6)


def test_many_outcomes_show_the_law():
    """20,000 drawn outcomes outweigh the prior."""
    found = fit_connection_law(*drawn(-0.6, 1.3, 20_000), np.ones(20_000))
    assert (found.intercept, found.slope) == pytest.approx((-0.6, 1.3), abs=0.06)


def test_no_outcome_is_the_neutral_law():
    """Nothing known, nothing changed."""
    nothing = fit_connection_law(np.zeros(0), np.zeros(0, dtype=bool), np.zeros(0))
    assert (nothing.intercept, nothing.slope) == (0.0, pytest.approx(NEUTRAL_SLOPE))


@pytest.mark.parametrize("connected", [True, False])
def test_extreme_outcomes_stay_finite(connected):
    """A thousand outcomes of one kind against their scores: a law, not an overflow."""
    scores = np.full(1000, -40.0 if connected else 40.0)
    found = fit_connection_law(scores, np.full(1000, connected), np.ones(1000))
    assert 0.0 < found.slope < NEUTRAL_SLOPE and np.isfinite(found.intercept)


def test_weight_is_a_number_of_outcomes():
    """Twice the weight is the outcome twice."""
    scores, connected = drawn(0.3, 1.5, 50)
    twice = fit_connection_law(np.tile(scores, 2), np.tile(connected, 2), np.ones(100))
    weighed = fit_connection_law(scores, connected, np.full(50, 2.0))
    assert (twice.intercept, twice.slope) == pytest.approx((weighed.intercept, weighed.slope))
