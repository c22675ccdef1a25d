"""What measurements say of predicted probabilities of connection, and the law that follows.

Each outcome compares a prediction with what was then measured: was the power at least the
threshold? The first measurements are predicted from all others (leave one out); each later one from
those before it, as the robot that took it did. The calibrated law
(:mod:`planopt.channel.connection.connection_law`) is fitted to these outcomes and fitted again with
each measurement.

The law assumes that outcomes at places to come are like those at measured ones of equal score. It
corrects the shape of the predictive law, and what driving selects among places, as far as the
outcomes show it; it does not know that some streets are worse than others.

Fit of the calibrated law to outcomes: penalised logistic regression.

The outcomes are few and mostly of one kind, so that a prior holds the law near the neutral one: the
intercept is normal about 0, the logarithm of the slope about that of the neutral slope. Within two
deviations of the prior, what the normal law calls 0.8 may be anything from 0.43 to 0.96. What is
fitted is the mode.

Predict measurements from all others, in closed form from the factor that is there.

With U the measurements' covariance, e_i the i-th unit vector, w = L^-1 e_i and theta by generalised
least squares with covariance M, column i of Q = U^-1 - U^-1 Gamma M Gamma' U^-1 follows from w. The
prediction of measurement i from all others is off by [Q y]_i / Q_ii, with variance 1 / Q_ii, its
own noise included (Dubrule, "Cross validation of kriging in a unique neighborhood", 1983). Where
there is no factor, the nearest others stand for all, with theta of all measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.connection.connection_law import (
    LEAST_DEVIATION_DB,
    NEUTRAL_SLOPE,
    ConnectionLaw,
)
from planopt.channel.estimation.vecchia import EARLIER_NEIGHBOURS, regress_on_neighbours
from planopt.channel.factor import whiten
from planopt.channel.mean_model import regressors
from planopt.channel.measurements import Measurements
from planopt.channel.prediction import KrigingTerms, Prediction, combine

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior

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


def leave_one_out(posterior: ChannelPosterior, rows: NDArray[np.intp]) -> Prediction:
    """Predict the powers of some measurements from all measurements but the one in question.

    The parameters xi, beta and omega stay those fitted to all, and a Gaussian site that stands for
    a censored measurement stays as it is.

    Parameters
    ----------
    posterior
        At least two measurements; theta known or estimated by generalised least squares.
    rows
        ``(k,)`` which of them.

    Returns
    -------
    Prediction
        ``(k,)`` of the power that would be measured, as
        :meth:`planopt.channel.posterior.ChannelPosterior.predict` gives it.
    """
    if not posterior.has_factor:
        return _from_nearest(posterior, rows)
    unit = np.zeros((len(posterior.measurements), len(rows)))
    unit[rows, np.arange(len(rows))] = 1.0
    whitened = whiten(posterior.factor, unit)
    gamma = posterior.whitened_regressors
    across = gamma.T @ whitened
    residual = posterior.whitened_values - gamma @ posterior.theta
    precision = np.einsum("ij,ij->j", whitened, whitened)
    precision -= np.einsum("ij,ik,kj->j", across, posterior.theta_covariance, across)
    mean = posterior.values_db[rows] - (residual @ whitened) / precision
    latent = np.maximum(1.0 / precision - posterior.noise_variance_db2[rows], 0.0)
    return Prediction(mean, np.sqrt(latent + posterior.parameters.multipath_std_db**2))


def _from_nearest(posterior: ChannelPosterior, rows: NDArray[np.intp]) -> Prediction:
    """Predict from the nearest others."""
    parameters, places_m = posterior.parameters, posterior.measurements.positions_m
    found, _ = posterior.index.nearest(places_m[rows], EARLIER_NEIGHBOURS + 1)
    # Itself is among them, or as many others at the very same place are.
    itself = found == rows[:, None]
    itself[~itself.any(axis=1), -1] = True
    near = found[~itself].reshape(len(rows), -1)
    regression = regress_on_neighbours(
        parameters,
        posterior.origins.at(rows[:, None]),
        posterior.origins.at(near),
        posterior.noise_variance_db2[near],
        np.zeros(near.shape, dtype=bool),
    )
    beside = regressors(places_m[near], parameters.station)
    data = np.einsum("km,km->k", regression.weights, posterior.values_db[near])
    trend = regressors(places_m[rows], parameters.station)
    trend = trend - np.einsum("km,kmi->ki", regression.weights, beside)
    variance = regression.variance_db2 + parameters.multipath_std_db**2
    return combine(KrigingTerms(data, trend, variance), posterior.theta, posterior.theta_covariance)


LEFT_OUT = 500
"""At most so many of the first measurements are left out in turn, evenly among them."""

LEFT_OUT_WEIGHT = 0.5
"""An outcome at a first measurement counts so much of one on the way: there, measurements are
nearer, and places are those that plans prefer. Over driven runs on two ray-traced maps and four
drawn channels 0.3, 0.5 and 1 came within 0.003 of each other in the logarithmic score of a step."""

REMEMBERED = 500
"""At most so many outcomes on the way count, the latest."""


@dataclass(frozen=True, eq=False)
class ConnectionOutcomes:
    """Outcomes of predictions of one station's connection, and the law fitted to them.

    Attributes
    ----------
    threshold_dbm
        From which power on a place is connected.
    scores
        ``(n,)`` (mean - threshold) / deviation of each prediction.
    connected
        ``(n,)`` whether the power was at least the threshold.
    left_out
        How many of them, the first ones, are at first measurements.
    law
        Fitted to the outcomes.
    """

    threshold_dbm: float
    scores: NDArray[np.float64] = field(repr=False)
    connected: NDArray[np.bool_] = field(repr=False)
    left_out: int
    law: ConnectionLaw


def calibrate_posterior(posterior: ChannelPosterior, threshold_dbm: float) -> ChannelPosterior:
    """Begin the calibration of a posterior from its measurements, each left out in turn.

    Parameters
    ----------
    posterior
        From the first measurements; theta known or estimated by generalised least squares.
    threshold_dbm
        From which power on a place is connected.

    Returns
    -------
    ChannelPosterior
        The same with outcomes. Posteriors that extend it go on with them.
    """
    count = len(posterior.measurements)
    chosen = np.unique(np.linspace(0, count - 1, min(count, LEFT_OUT)).round().astype(np.intp))
    begun = ConnectionOutcomes(
        threshold_dbm, np.zeros(0), np.zeros(0, dtype=bool), 0, ConnectionLaw()
    )
    if count > 1:
        taken = posterior.measurements.take(chosen)
        scores, connected = _compared(leave_one_out(posterior, chosen), taken, threshold_dbm)
        begun = replace(begun, scores=scores, connected=connected, left_out=len(scores))
    return replace(posterior, outcomes=_fitted(begun))


def add_outcomes(
    outcomes: ConnectionOutcomes, prediction: Prediction, measured: Measurements
) -> ConnectionOutcomes:
    """Count what was measured on the way, and fit the law again.

    Parameters
    ----------
    outcomes
        So far.
    prediction
        Of the powers of `measured`, made without them.
    measured
        n measurements.
    """
    scores, connected = _compared(prediction, measured, outcomes.threshold_dbm)
    first = outcomes.left_out
    latest = max(first, len(outcomes.scores) + len(scores) - REMEMBERED)
    kept = np.r_[:first, latest : len(outcomes.scores)]
    return _fitted(
        replace(
            outcomes,
            scores=np.concatenate([outcomes.scores[kept], scores]),
            connected=np.concatenate([outcomes.connected[kept], connected]),
        )
    )


def _fitted(outcomes: ConnectionOutcomes) -> ConnectionOutcomes:
    """Fit the law to the outcomes."""
    weights = np.ones(len(outcomes.scores))
    weights[: outcomes.left_out] = LEFT_OUT_WEIGHT
    law = fit_connection_law(outcomes.scores, outcomes.connected, weights)
    return replace(outcomes, law=law)


def _compared(
    prediction: Prediction, measured: Measurements, threshold_dbm: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Scores and outcomes, where a censored measurement tells which it was."""
    known = ~measured.censored | (measured.power_dbm < threshold_dbm)
    deviation = np.maximum(prediction.deviation_db, LEAST_DEVIATION_DB)
    scores = (prediction.mean_db - threshold_dbm) / deviation
    return scores[known], (measured.power_dbm >= threshold_dbm)[known]
