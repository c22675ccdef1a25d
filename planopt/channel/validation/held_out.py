"""Predict whole walks that were held out, by the channel and by path loss alone.

Points beside a training point are easily predicted, so points held out at random flatter. What is
held out here are whole groups, if it is to say how the channel is known where nobody has been.

A ratio of sums over independent groups, with an interval that counts groups, not members.

Errors within one walk, or within one map, belong together: thousands of them may tell no more than
a handful of independent ones. The variance of a ratio of sums follows from how the groups differ
from it (the linearised ratio estimator of cluster sampling), and Student's t with one degree of
freedom less than groups allows for there being few. With few groups of unequal size the interval
is still a rough one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.fit import fitted_parameters
from planopt.channel.estimation.identifiability import examine
from planopt.channel.estimation.least_squares import least_squares
from planopt.channel.joint import predict_readings
from planopt.channel.measurements import Measurements
from planopt.channel.parameter_uncertainty import marginalise
from planopt.channel.parameters import ChannelParameters, Station, mean_model, regressors
from planopt.channel.posterior import condition
from planopt.channel.prediction import Prediction
from planopt.errors import InputError

Predictor = Callable[[Measurements], Prediction]
"""From measurements to what they would read; their powers are not looked at."""

MARGINAL_EXACT_LIMIT = 1000
"""From more measurements the marginalised channel predicts by the nearest, as each of its some 15
components would cost a factor. With days of the campus logs held out the RMSE of the channel itself
is then 6.53 dB instead of 6.48."""


def learn_channel(measurements: Measurements, station: Station) -> Predictor:
    """Fit by restricted likelihood, then predict by the posterior (equation 1.8)."""
    return channel_predictor(fitted_parameters(measurements, station), measurements)


def learn_marginal(measurements: Measurements, station: Station) -> Predictor:
    """The same with the uncertainty of xi, beta and omega counted."""
    return marginal_predictor(fitted_parameters(measurements, station), measurements)


def channel_predictor(fit: ChannelFit | ChannelParameters, measurements: Measurements) -> Predictor:
    """Predict from the measurements that were fitted (equation 1.8)."""
    return partial(predict_readings, condition(parameters_of(fit), measurements))


def marginal_predictor(
    fit: ChannelFit | ChannelParameters, measurements: Measurements
) -> Predictor:
    """The same with the uncertainty of xi, beta and omega counted."""
    posterior = marginalise(parameters_of(fit), measurements, MARGINAL_EXACT_LIMIT)
    return partial(predict_readings, posterior)


def parameters_of(fit: ChannelFit | ChannelParameters) -> ChannelParameters:
    """Return the parameters of a fit, or what is given if it is parameters."""
    return fit if isinstance(fit, ChannelParameters) else fit.parameters


def learn_path_loss(measurements: Measurements, station: Station) -> Predictor:
    """Path loss alone by least squares, with the deviation it leaves: what to beat."""
    if measurements.censored.all():
        raise InputError("there is no line through upper limits alone")
    identifiable = examine(measurements, station).n_pl_reason is None
    model = mean_model(measurements.positions_m, ~measurements.censored, station, identifiable)
    line = least_squares(model, measurements)
    theta = np.array(model.theta(line.coefficients))
    deviation_db = float(np.sqrt(line.variance_db2))

    def predict(readings: Measurements) -> Prediction:
        return Prediction(
            regressors(readings.positions_m, station) @ theta, np.full(len(readings), deviation_db)
        )

    return predict


def held_out_predictions(
    measurements: Measurements,
    fold_of: NDArray[np.intp],  # (n,)
    learn: Callable[[Measurements], Mapping[str, Predictor]],
) -> dict[str, Prediction]:
    """Predict every measurement from models learnt without its fold."""
    folds = np.unique(fold_of)
    if fold_of.shape != (len(measurements),) or len(folds) < 2:
        raise InputError(
            f"{len(measurements)} measurements are not held out in {len(folds)} folds",
            key="folds",
            remedy="give each measurement a fold, of two or more",
        )
    found: dict[str, Prediction] = {}
    for fold in folds:
        out = fold_of == fold
        held_out = measurements.take(out)
        for name, predict in learn(measurements.take(~out)).items():
            if name not in found:
                found[name] = Prediction(*np.empty((2, len(measurements))))
            part = predict(held_out)
            found[name].mean_db[out] = part.mean_db
            found[name].deviation_db[out] = part.deviation_db
    return found


def deal(groups: NDArray[np.intp], folds: int, generator: np.random.Generator) -> NDArray[np.intp]:
    """Deal whole groups into folds at random; ``(n,)`` fold of each measurement.

    Parameters
    ----------
    groups
        ``(n,)`` label of each one's group.
    folds
        At least 2, at most as many as there are groups.
    generator
        Source of randomness.

    Raises
    ------
    InputError
        There are fewer groups than folds, or fewer than two folds.
    """
    labels, group_of = np.unique(groups, return_inverse=True)
    if not 2 <= folds <= len(labels):
        raise InputError(
            f"{len(labels)} groups cannot be dealt into {folds} folds",
            key="folds",
            remedy="use at least 2 folds and no more than there are groups",
        )
    return (generator.permutation(len(labels)) % folds)[group_of]


LEVEL = 0.95
"""Of the interval."""


@dataclass(frozen=True)
class GroupedRatio:
    """A ratio of sums with its interval.

    Attributes
    ----------
    value
        The ratio.
    low, high
        Its 95 % interval, not below zero.
    """

    value: float
    low: float
    high: float

    def root(self) -> GroupedRatio:
        """The square root, for a ratio of squares."""
        return GroupedRatio(math.sqrt(self.value), math.sqrt(self.low), math.sqrt(self.high))


def grouped_ratio(
    numerators: NDArray[np.float64], denominators: NDArray[np.float64]
) -> GroupedRatio:
    """Ratio of the sums of two quantities over groups.

    Parameters
    ----------
    numerators, denominators
        ``(g,)`` sums of either within each group, not negative: squared errors and their number
        for a mean squared error, powers inside an interval and all of them for its coverage.

    Raises
    ------
    InputError
        There are fewer than two groups, or nothing to divide by.
    """
    groups = len(numerators)
    total = float(denominators.sum())
    if groups < 2 or total <= 0.0:
        raise InputError(
            f"{groups} groups of {total:g} in all give no interval",
            remedy="give two groups or more that have something in them",
        )
    ratio = float(numerators.sum()) / total
    half = float(stdtrit(groups - 1.0, 0.5 + 0.5 * LEVEL)) * ratio_error(numerators, denominators)
    return GroupedRatio(ratio, max(ratio - half, 0.0), ratio + half)


def ratio_error(numerators: NDArray[np.float64], denominators: NDArray[np.float64]) -> float:
    """Return the linearised standard error of a ratio of sums over two groups or more.

    Parameters as of :func:`grouped_ratio`.
    """
    groups, total = len(numerators), float(denominators.sum())
    apart = numerators - float(numerators.sum()) / total * denominators
    return math.sqrt(groups / (groups - 1.0) * float(apart @ apart)) / total
