"""Report a fitted channel on held-out walks: error and coverage, against path loss alone.

All intervals are over the groups that were held out whole
(:mod:`planopt.channel.validation.held_out`): powers of one walk are not independent.

What anybody would try first on a log: a least-squares line, and a plain Gaussian process.

Neither knows of upper limits: both leave them out, as if nothing had been measured there. The
Gaussian process has a constant mean and no path loss; its kernel is exponential with white noise,
and its parameters are those of the largest marginal likelihood on a grid. With days of a campus log
held out that kernel had an RMSE of 6.3 dB, the squared-exponential one 7.0 dB. They are here to be
compared with, not to plan by.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import log_determinant, lower_factor, solve_lower
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.identifiability import examine, nearest_distance_m
from planopt.channel.estimation.likelihood_climb import thinned
from planopt.channel.measurement_covariance import pairwise_distance_m
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters, Station, mean_model, regressors
from planopt.channel.prediction import Prediction, connection_probability
from planopt.channel.validation.calibration import (
    LEVELS,
    Calibration,
    ReliabilityBin,
    calibrate,
    reliability,
)
from planopt.channel.validation.held_out import (
    GroupedRatio,
    Predictor,
    channel_predictor,
    grouped_ratio,
    held_out_predictions,
    learn_path_loss,
    marginal_predictor,
    parameters_of,
)
from planopt.errors import InputError
from planopt.short_repr import short_repr

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
    """A Gaussian process of what is not an upper limit."""
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
    """Return measurements that are no upper limits, in an order independent of the rows'."""
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
    return math.exp(log), _logistic(logit)


def _best(
    distance_m: NDArray[np.float64], centred_db: NDArray[np.float64], points: Iterable[Point]
) -> Point:
    """The most likely of some points, the variance profiled out."""

    def log_likelihood(point: Point) -> float:
        lower = lower_factor(_correlation(distance_m, math.exp(point[0]), _logistic(point[1])))
        half = solve_lower(lower, centred_db)
        count = len(half)
        variance = max(float(half @ half) / count, LEAST_VARIANCE_DB2)
        return -0.5 * (count * math.log(variance) + log_determinant(lower))

    return max(points, key=log_likelihood)


def _logistic(logit: float) -> float:
    return 1.0 / (1.0 + math.exp(-logit))


PATH_LOSS = "path_loss"
"""The predictor that others are compared with."""


@dataclass(frozen=True)
class HeldOutScore:
    """The errors of one predictor on held-out measurements.

    Attributes
    ----------
    rmse_db
        Root mean squared error, upper limits left out.
    of_path_loss
        That over the RMSE of path loss alone, on the same powers.
    coverage
        By level, share of powers within the central interval; upper limits count in parts, as in
        :mod:`planopt.channel.validation.calibration`.
    calibration
        Of all powers at once, with the histogram of the PIT; its own intervals take powers for
        independent.
    reliability
        Predicted probability of a power of at least the report's threshold, against how often it
        was. Upper limits at or above the threshold do not tell, and are left out.
    """

    rmse_db: GroupedRatio
    of_path_loss: GroupedRatio
    coverage: dict[float, GroupedRatio]
    calibration: Calibration
    reliability: tuple[ReliabilityBin, ...]


@dataclass(frozen=True)
class HeldOutReport:
    """Held-out measurements, and the errors of each predictor on them.

    Attributes
    ----------
    groups
        Number of groups held out whole.
    fold_sizes
        Measurements held out at once, fold by fold.
    measurements, censored
        How many in all, and how many of them are upper limits.
    threshold_dbm
        A power of at least this counts as connected.
    scores
        By predictor; :data:`PATH_LOSS` is one of them.
    """

    groups: int
    fold_sizes: tuple[int, ...]
    measurements: int
    censored: int
    threshold_dbm: float
    scores: dict[str, HeldOutScore]

    __repr__ = short_repr


def predictors_of(
    fit: Callable[[Measurements], ChannelFit | ChannelParameters],
) -> Callable[[Measurements], dict[str, Predictor]]:
    """Return the predictors that are compared: the learnt channel, its rivals, path loss alone.

    The channel with its covariance marginalised, and what knows no upper limits: a least-squares
    line and a Gaussian process (:mod:`planopt.channel.validation.held_out_report`). `fit` fits any
    measurements, once for all; its parameters are enough
    (:func:`planopt.channel.estimation.fit.fitted_parameters`).
    """

    def learn(measurements: Measurements) -> dict[str, Predictor]:
        found = fit(measurements)
        station = parameters_of(found).station
        return {
            "channel": channel_predictor(found, measurements),
            "marginal": marginal_predictor(found, measurements),
            PATH_LOSS: learn_path_loss(measurements, station),
            "plain_line": learn_plain_line(measurements, station),
            "plain_process": learn_plain_process(measurements),
        }

    return learn


@one_blas_thread()
def held_out_report(
    measurements: Measurements | Table,
    groups: NDArray[np.intp],
    fold_of: NDArray[np.intp],
    learn: Callable[[Measurements], Mapping[str, Predictor]],
    threshold_dbm: float | None = None,
) -> HeldOutReport:
    """Predict every fold from the others, and score it.

    Parameters
    ----------
    measurements
        All of them.
    groups
        ``(n,)`` label of the group of each.
    fold_of
        ``(n,)`` fold of each, as :func:`planopt.channel.validation.held_out.deal` gives it.
    learn
        What learns, as :func:`predictors_of` makes it; path loss among it.
    threshold_dbm
        A power of at least this counts as connected; None for the median power, so that half of
        them are.

    Raises
    ------
    InputError
        Measurements, groups and folds do not belong together; a fit of a part of the measurements
        is impossible; or there are upper limits only.
    """
    measurements = as_measurements(measurements)
    if groups.shape != (len(measurements),):
        raise InputError("there is not one group label a measurement", key="groups")
    predictions = held_out_predictions(measurements, fold_of, learn)
    labels, group_of = np.unique(groups, return_inverse=True)
    everyone = [np.flatnonzero(group_of == group) for group in range(len(labels))]
    reference = _squares(predictions[PATH_LOSS], measurements, everyone)
    if threshold_dbm is None:
        threshold_dbm = float(np.median(measurements.power_dbm))
    return HeldOutReport(
        len(labels),
        tuple(int((fold_of == fold).sum()) for fold in np.unique(fold_of)),
        len(measurements),
        int(measurements.censored.sum()),
        threshold_dbm,
        {
            name: _score(
                prediction,
                measurements,
                everyone,
                reference,
                _reliability(prediction, measurements, group_of, threshold_dbm),
            )
            for name, prediction in predictions.items()
        },
    )


def _score(
    prediction: Prediction,
    measurements: Measurements,
    everyone: list[NDArray[np.intp]],
    reference: NDArray[np.float64],
    table: tuple[ReliabilityBin, ...],
) -> HeldOutScore:
    """Score one prediction; `reference` are the squared errors of path loss alone by group."""
    sizes = np.array([float(len(rows)) for rows in everyone])
    exact = np.array([float((~measurements.censored[rows]).sum()) for rows in everyone])
    parts = [calibrate(_of(prediction, rows), measurements.take(rows), LEVELS) for rows in everyone]
    squares = _squares(prediction, measurements, everyone)
    return HeldOutScore(
        grouped_ratio(squares, exact).root(),
        grouped_ratio(squares, reference).root(),
        {
            level: _share(sizes * np.array([part.coverage[index].share for part in parts]), sizes)
            for index, level in enumerate(LEVELS)
        },
        calibrate(prediction, measurements),
        table,
    )


def _reliability(
    prediction: Prediction,
    measurements: Measurements,
    group_of: NDArray[np.intp],
    threshold_dbm: float,
) -> tuple[ReliabilityBin, ...]:
    """Predicted against realised power of at least the threshold, where that is known."""
    known = ~measurements.censored | (measurements.power_dbm < threshold_dbm)
    predicted = connection_probability(prediction.mean_db, prediction.deviation_db, threshold_dbm)
    return reliability(
        predicted[known], measurements.power_dbm[known] >= threshold_dbm, group_of[known]
    )


def _share(inside: NDArray[np.float64], sizes: NDArray[np.float64]) -> GroupedRatio:
    """A share, whose interval ends at one."""
    found = grouped_ratio(inside, sizes)
    return replace(found, high=min(found.high, 1.0))


def _squares(
    prediction: Prediction, measurements: Measurements, everyone: list[NDArray[np.intp]]
) -> NDArray[np.float64]:
    """Summed squared error of the powers that are not upper limits, by group."""
    error = np.where(measurements.censored, 0.0, measurements.power_dbm - prediction.mean_db)
    return np.array([float((error[rows] ** 2).sum()) for rows in everyone])


def _of(prediction: Prediction, rows: NDArray[np.intp]) -> Prediction:
    return Prediction(prediction.mean_db[rows], prediction.deviation_db[rows])
