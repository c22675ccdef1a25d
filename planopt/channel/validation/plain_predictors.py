"""What anybody would try first on a log: a least-squares line, and a plain Gaussian process.

Neither knows of upper limits: both leave them out, as if nothing had been measured there. The
Gaussian process has a constant mean and no path loss; its kernel is exponential with white noise,
and its parameters are those of the largest marginal likelihood on a grid. With days of a campus log
held out that kernel had an RMSE of 6.3 dB, the squared-exponential one 7.0 dB. They are here to be
compared with, not to plan by.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import log_determinant, lower_factor, solve_lower
from planopt.channel.estimation.identifiability import examine, nearest_distance_m
from planopt.channel.estimation.likelihood_starts import thinned
from planopt.channel.kernel import pairwise_distance_m
from planopt.channel.mean_model import mean_model
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import Station
from planopt.channel.path_loss import regressors
from planopt.channel.prediction import Prediction
from planopt.channel.validation.held_out import Predictor
from planopt.errors import InputError

MOST_LIKELIHOOD, MOST_CONDITIONED = 400, 4_000
"""Of more powers a fixed draw gives the likelihood, and of more a draw is conditioned on: the cost
grows with the cube."""

FEWEST_PLACES = 6
"""In fewer places there is no correlation to see: the process is its mean and deviation."""

LENGTHS, LOGITS = 7, (-3.0, -1.5, 0.0, 1.5, 3.0)
"""How many length scales, and which shares of noise by their logits, the grid has."""

FINER = (-2.0 / 3.0, -1.0 / 3.0, 0.0, 1.0 / 3.0, 2.0 / 3.0)
"""Of the finer grid about the best point, in steps of the first one."""

LEAST_VARIANCE_DB2 = 1e-6

Point = tuple[float, float]
"""Logarithm of the length scale in metres, and logit of the share of noise."""


def learn_plain_line(measurements: Measurements, station: Station) -> Predictor:
    """Power by the logarithm of distance, by least squares of what is not an upper limit.

    At one distance, the mean with an assumed slope.

    Raises
    ------
    InputError
        Every measurement is censored.
    """
    exact = _uncensored(measurements)
    everyone = np.ones(len(exact), dtype=np.bool_)
    slope = examine(exact, station).n_pl_reason is None
    model = mean_model(exact.positions_m, everyone, station, slope)
    values = exact.power_dbm - model.offset_db
    coefficients, *_ = np.linalg.lstsq(model.columns, values, rcond=None)
    left = values - model.columns @ coefficients
    freedom = max(len(left) - model.columns.shape[1], 1)
    deviation_db = math.sqrt(max(float(left @ left) / freedom, LEAST_VARIANCE_DB2))
    theta = np.array(model.theta(np.asarray(coefficients, dtype=np.float64)))

    def predict(readings: Measurements) -> Prediction:
        mean = regressors(readings.positions_m, station) @ theta
        return Prediction(mean, np.full(len(mean), deviation_db))

    return predict


def learn_plain_process(measurements: Measurements) -> Predictor:
    """A Gaussian process of what is not an upper limit.

    Raises
    ------
    InputError
        Every measurement is censored.
    """
    exact = _uncensored(measurements)
    exact = exact.take(thinned(len(exact), MOST_CONDITIONED))
    mean_db = float(exact.power_dbm.mean())
    centred = exact.power_dbm - mean_db
    some = exact.take(thinned(len(exact), MOST_LIKELIHOOD)).positions_m
    length_m, noise = math.inf, 1.0
    if len(np.unique(some, axis=0)) >= FEWEST_PLACES:
        length_m, noise = _most_likely(some, centred[thinned(len(exact), MOST_LIKELIHOOD)])
    lower = lower_factor(
        _correlation(pairwise_distance_m(exact.positions_m, exact.positions_m), length_m, noise)
    )
    whitened = solve_lower(lower, centred)
    variance_db2 = max(float(whitened @ whitened) / len(centred), LEAST_VARIANCE_DB2)

    def predict(readings: Measurements) -> Prediction:
        apart_m = pairwise_distance_m(exact.positions_m, readings.positions_m)
        across = solve_lower(lower, (1.0 - noise) * np.exp(-apart_m / length_m))
        left = np.maximum(1.0 - np.einsum("ij,ij->j", across, across), noise)
        return Prediction(mean_db + whitened @ across, np.sqrt(variance_db2 * left))

    return predict


def _uncensored(measurements: Measurements) -> Measurements:
    """What is not an upper limit, in an order that does not depend on that of the rows."""
    if measurements.censored.all():
        raise InputError("there is nothing to learn from upper limits alone")
    placed = measurements.by_place()
    return placed.take(np.flatnonzero(~placed.censored))


def _correlation(
    distance_m: NDArray[np.float64], length_m: float, noise: float
) -> NDArray[np.float64]:
    """Correlation of powers (n, n) of whose variance a share is `noise`."""
    correlation = (1.0 - noise) * np.exp(-distance_m / length_m)
    correlation[np.diag_indices(len(correlation))] = 1.0
    return correlation


def _most_likely(
    positions_m: NDArray[np.float64], centred_db: NDArray[np.float64]
) -> tuple[float, float]:
    """Length scale and share of noise of the largest likelihood, on a grid and a finer one."""
    distance_m = pairwise_distance_m(positions_m, positions_m)
    extent_m = float(distance_m.max())
    nearest_m = float(np.median(nearest_distance_m(np.unique(positions_m, axis=0))))
    logs = np.linspace(math.log(min(nearest_m, extent_m) / 3.0), math.log(extent_m), LENGTHS)
    steps = float(logs[1] - logs[0]), LOGITS[1] - LOGITS[0]
    log, logit = _best(
        distance_m, centred_db, ((float(one), two) for one in logs for two in LOGITS)
    )
    log, logit = _best(
        distance_m,
        centred_db,
        ((log + one * steps[0], logit + two * steps[1]) for one in FINER for two in FINER),
    )
    return math.exp(log), _share(logit)


def _best(
    distance_m: NDArray[np.float64], centred_db: NDArray[np.float64], points: Iterable[Point]
) -> Point:
    """The most likely of some points, the variance profiled out."""

    def log_likelihood(point: Point) -> float:
        lower = lower_factor(_correlation(distance_m, math.exp(point[0]), _share(point[1])))
        half = solve_lower(lower, centred_db)
        count = len(half)
        variance = max(float(half @ half) / count, LEAST_VARIANCE_DB2)
        return -0.5 * (count * math.log(variance) + log_determinant(lower))

    return max(points, key=log_likelihood)


def _share(logit: float) -> float:
    return 1.0 / (1.0 + math.exp(-logit))
