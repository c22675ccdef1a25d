"""The calibrated probability of a connection: its law, the fit to outcomes, and the outcomes.

With u = (mean - threshold) / deviation, the score of a prediction, the normal law says

    P(power >= threshold) = Phi(u).

The calibrated law (Platt, "Probabilistic outputs for support vector machines", 1999) is

    logit P(power >= threshold) = intercept + slope u,

a logistic law of the power about a shifted mean, whose tails are heavier than the normal one's. Its
quantiles have the same form as the normal ones: the bound P >= p_min is

    mean - q_p deviation - threshold >= 0,    q_p = (logit p_min - intercept) / slope.

:data:`NEUTRAL_SLOPE` with intercept 0 is the logistic law nearest to the normal one.

Each outcome compares a prediction with the later measurement: was the power at least the threshold?
The first measurements are predicted from all others (leave one out), each later one from those
before it, as the robot that took it did. The law is fitted to these outcomes by penalised logistic
regression and fitted again with each measurement. Outcomes are few and mostly of one kind, so a
prior holds the law near the neutral one: the intercept is normal about 0, the logarithm of the
slope about that of the neutral slope. Within two deviations of the prior, what the normal law calls
0.8 may be anything from 0.43 to 0.96. The fit is the mode.

Leaving one out takes no new factor. With U the measurements' covariance, e_i the i-th unit vector,
w = L^-1 e_i and theta by generalised least squares with covariance M, column i of
Q = U^-1 - U^-1 Gamma M Gamma' U^-1 follows from w. The prediction of measurement i from all others
is off by [Q y]_i / Q_ii, with variance 1 / Q_ii, its own noise included (Dubrule, "Cross validation
of kriging in a unique neighborhood", 1983). Without a factor the nearest others stand for all, with
theta of all measurements.

The law assumes that outcomes at future places are like those at measured ones of equal score. It
corrects the shape of the predictive law, and the selection of places by driving, as far as the
outcomes show it; it does not know that some streets are worse than others.

A :class:`SampledDistribution` is a number known by draws, with the intervals that their count
leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import (  # pyright: ignore[reportUnknownVariableType]
    betaincinv,  # pyright: ignore[reportUnknownVariableType]
    expit,  # pyright: ignore[reportUnknownVariableType]
    log_expit,
    ndtri_exp,
)

from planopt.channel.estimation.vecchia import EARLIER_NEIGHBOURS, regress_on_neighbours
from planopt.channel.factor import whiten
from planopt.channel.intervals.censoring import MIN_NOISE_VARIANCE_DB2
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import regressors
from planopt.channel.prediction import KrigingTerms, Prediction, bound_quantile, combine
from planopt.errors import InputError
from planopt.short_repr import short_repr

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior

NEUTRAL_SLOPE = 1.702
"""The logistic law of this slope is within 0.0095 of the normal law everywhere (Haley 1952)."""

LEAST_DEVIATION_DB = math.sqrt(MIN_NOISE_VARIANCE_DB2)
"""Powers that are known would be steps; so little spread decides ties evenly."""

SECANT_FROM = 1e-6
"""Nearer to the quantile the slope of the normal score stands for its secant."""

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


@dataclass(frozen=True)
class ConnectionLaw:
    """The probability of connection as a function of the prediction's score."""

    intercept: float = 0.0  # Logit of the probability where the predicted mean is at the threshold
    slope: float = NEUTRAL_SLOPE  # By how much the logit grows with a deviation; above 0

    def quantile(self, p_min: float) -> float:
        """q_p: the score from which on the probability is at least `p_min`, between 0 and 1."""
        return (math.log(p_min) - math.log1p(-p_min) - self.intercept) / self.slope

    def normal_score(self, score: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return h with Phi(h) the probability at `score`; shapes alike, NaN where that is."""
        logit = self.intercept + self.slope * score
        tail = np.asarray(ndtri_exp(log_expit(-np.abs(logit))), dtype=np.float64)
        return np.where(logit < 0.0, tail, -tail)

    def normal_score_derivatives(
        self, score: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return h, dh/du and d2h/du2 at `score`.

        With G the probability: h' = slope G (1 - G) / phi(h), h'' = h' (slope (1 - 2 G) + h h').
        """
        logit = self.intercept + self.slope * score
        h = self.normal_score(score)
        log_up, log_down = log_expit(logit), log_expit(-logit)
        first = self.slope * np.exp(log_up + log_down + 0.5 * h * h + LOG_ROOT_2PI)
        second = first * (-self.slope * np.tanh(0.5 * logit) + h * first)
        return h, first, second

    def prediction(self, raw: Prediction, threshold_dbm: float, p_min: float = 0.0) -> Prediction:
        """Return the normal law that agrees with the calibrated one where it counts.

        Its probability of a power of at least the threshold is the calibrated one, and so is the
        power that it exceeds with probability `p_min`, and with it the margin in dB. Where `p_min`
        asks for nothing (0), it has the slope of the calibrated law at the threshold.
        """
        deviation = np.maximum(raw.deviation_db, LEAST_DEVIATION_DB)
        score = (raw.mean_db - threshold_dbm) / deviation
        normal, slope, _ = self.normal_score_derivatives(score)
        spread = 1.0 / slope
        if p_min > 0.0:
            away = score - self.quantile(p_min)
            far = np.abs(away) > SECANT_FROM
            np.divide(away, normal - bound_quantile(p_min), out=spread, where=far)
        spread *= deviation
        return Prediction(threshold_dbm + spread * normal, spread)


CONFIDENCE = 0.95
"""Probability that an :class:`Interval` contains the true value."""


@dataclass(frozen=True)
class Interval:
    """An estimate and its 95 % confidence interval."""

    value: float  # The estimate
    low: float  # Ends of the interval
    high: float


@dataclass(frozen=True, eq=False)
class SampledDistribution:
    """Independent draws of one number.

    Attributes
    ----------
    draws
        ``(count,)`` in the order drawn, count at least 2.
    """

    draws: NDArray[np.float64]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.draws.ndim != 1 or len(self.draws) < 2:
            raise InputError(
                f"draws of shape {self.draws.shape} are no distribution",
                key="count",
                remedy="draw at least 2",
            )

    @property
    def count(self) -> int:
        """Return how many draws."""
        return len(self.draws)

    def mean(self) -> Interval:
        """The mean, its interval by the central limit theorem."""
        value = float(self.draws.mean())
        half = _half_width() * float(self.draws.std(ddof=1)) / math.sqrt(self.count)
        return Interval(value, value - half, value + half)

    def quantile(self, share: float) -> Interval:
        """The value that is not exceeded with probability `share`; the interval by ranks.

        Raises
        ------
        InputError
            `share` is not from 0 to 1.
        """
        if not 0.0 <= share <= 1.0:
            raise InputError(f"{share!r} is no probability", key="share", remedy="give 0 to 1")
        half = _half_width() * math.sqrt(share * (1.0 - share) / self.count)
        shares = np.clip([share, share - half, share + half], 0.0, 1.0)
        value, low, high = np.quantile(self.draws, shares, method="inverted_cdf").tolist()
        return Interval(value, low, high)

    def exceedance(self, limit: float) -> Interval:
        """P(more than `limit`), with Clopper and Pearson's interval, which holds at any count."""
        above = float((self.draws > limit).sum())
        below = self.count - above
        tail = 0.5 * (1.0 - CONFIDENCE)
        low = 0.0 if above == 0.0 else _beta_quantile(above, below + 1.0, tail)
        high = 1.0 if below == 0.0 else _beta_quantile(above + 1.0, below, 1.0 - tail)
        return Interval(above / self.count, low, high)


def _half_width() -> float:
    """Return half the width of an interval of a normal law, in its standard deviations."""
    return bound_quantile(0.5 + 0.5 * CONFIDENCE)


def _beta_quantile(first: float, second: float, share: float) -> float:
    return float(np.asarray(betaincinv(first, second, share), dtype=np.float64))


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
    """Return the mode of intercept and slope given outcomes."""
    # Shapes: scores (n,); connected (n,); weights (n,).
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
    """
    # Shapes: rows (k,); returns (k,).
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
    """Outcomes of predictions of one station's connection, and the law fitted to them."""

    threshold_dbm: float  # From which power on a place is connected
    # (n,) (mean - threshold) / deviation of each prediction
    scores: NDArray[np.float64] = field(repr=False)
    # (n,) whether the power was at least the threshold
    connected: NDArray[np.bool_] = field(repr=False)
    left_out: int  # How many of them, the first ones, are at first measurements
    law: ConnectionLaw  # Fitted to the outcomes


def calibrate_posterior(posterior: ChannelPosterior, threshold_dbm: float) -> ChannelPosterior:
    """Begin the calibration of a posterior from its measurements, each left out in turn."""
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
    """Count what was measured on the way, and fit the law again."""
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
