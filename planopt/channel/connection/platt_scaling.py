"""Fit of the calibrated law to outcomes: penalised logistic regression.

The outcomes are few and mostly of one kind, so that a prior holds the law near the neutral one: the
intercept is normal about 0, the logarithm of the slope about that of the neutral slope. Within two
deviations of the prior, what the normal law calls 0.8 may be anything from 0.43 to 0.96. What is
fitted is the mode.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.connection.connection_law import NEUTRAL_SLOPE, ConnectionLaw

INTERCEPT_STD = 0.85
LOG_SLOPE_STD = 0.35
"""Deviations of the prior. Halving or doubling them changed the logarithmic score of driven runs by
less than 0.002 a step."""

MOST_ITERATIONS = 50
LARGEST_STEP = 0.5
"""Of intercept and logarithm of the slope in one iteration."""

SETTLED = 1e-9


def fit_connection_law(
    scores: NDArray[np.float64], connected: NDArray[np.bool_], weights: NDArray[np.float64]
) -> ConnectionLaw:
    """Return the mode of intercept and slope given outcomes.

    Parameters
    ----------
    scores
        ``(n,)`` (mean - threshold) / deviation of predictions.
    connected
        ``(n,)`` whether the power was at least the threshold.
    weights
        ``(n,)`` how much each outcome counts; 1 is once.
    """
    intercept, log_slope = 0.0, math.log(NEUTRAL_SLOPE)
    prior = np.array([INTERCEPT_STD**-2, LOG_SLOPE_STD**-2])
    columns = np.ones((len(scores), 2))
    for _ in range(MOST_ITERATIONS):
        columns[:, 1] = math.exp(log_slope) * scores
        chance = np.asarray(expit(intercept + columns[:, 1]), dtype=np.float64)
        away = np.array([intercept, log_slope - math.log(NEUTRAL_SLOPE)])
        gradient = columns.T @ (weights * (connected - chance)) - prior * away
        curvature = (columns.T * (weights * chance * (1.0 - chance))) @ columns + np.diag(prior)
        step = np.clip(np.linalg.solve(curvature, gradient), -LARGEST_STEP, LARGEST_STEP)
        intercept, log_slope = intercept + float(step[0]), log_slope + float(step[1])
        if np.abs(step).max() < SETTLED:
            break
    return ConnectionLaw(intercept, math.exp(log_slope))
