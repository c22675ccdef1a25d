"""What held-out walks say of a fitted channel: error and coverage, against path loss alone.

All intervals are over the groups that were held out whole
(:mod:`planopt.channel.validation.grouped_ratio`): powers of one walk are not independent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.prediction import Prediction
from planopt.channel.validation.calibration import LEVELS, Calibration, calibrate
from planopt.channel.validation.grouped_ratio import GroupedRatio, grouped_ratio
from planopt.channel.validation.held_out import (
    Predictor,
    channel_predictor,
    held_out_predictions,
    learn_path_loss,
    marginal_predictor,
)
from planopt.channel.validation.plain_predictors import learn_plain_line, learn_plain_process
from planopt.channel.validation.reliability import ReliabilityBin, reliability
from planopt.errors import InputError
from planopt.short_repr import short_repr

PATH_LOSS = "path_loss"
"""The predictor that others are compared with."""


@dataclass(frozen=True)
class HeldOutScore:
    """How one predictor did on what it had not seen.

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
    """What was held out, and how each predictor did.

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
    fit: Callable[[Measurements], ChannelFit],
) -> Callable[[Measurements], dict[str, Predictor]]:
    """What learns the channel, what it is compared with, and path loss alone.

    The channel with its covariance marginalised, and what knows no upper limits: a least-squares
    line and a Gaussian process (:mod:`planopt.channel.validation.plain_predictors`). `fit` fits any
    measurements; once for all.
    """

    def learn(measurements: Measurements) -> dict[str, Predictor]:
        found = fit(measurements)
        station = found.parameters.station
        return {
            "channel": channel_predictor(found, measurements),
            "marginal": marginal_predictor(found, measurements),
            PATH_LOSS: learn_path_loss(measurements, station),
            "plain_line": learn_plain_line(measurements, station),
            "plain_process": learn_plain_process(measurements),
        }

    return learn


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
