"""Predict whole walks that were held out, by the channel and by path loss alone.

Points beside a training point are easily predicted, so points held out at random flatter. What is
held out here are whole groups, if it is to say how the channel is known where nobody has been.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.fit import fit_channel
from planopt.channel.identifiability import examine
from planopt.channel.least_squares import least_squares
from planopt.channel.mean_model import mean_model
from planopt.channel.measurements import Measurements
from planopt.channel.parameter_uncertainty import marginalise
from planopt.channel.parameters import Station
from planopt.channel.path_loss import regressors
from planopt.channel.posterior import condition
from planopt.channel.prediction import Prediction
from planopt.errors import InputError

Predictor = Callable[[NDArray[np.float64]], Prediction]
"""From positions (n, 2) to the prediction there."""


def learn_channel(measurements: Measurements, station: Station) -> Predictor:
    """Path loss, shadowing and multipath by restricted likelihood, then Lemma 2."""
    return condition(fit_channel(measurements, station).parameters, measurements).predict


def learn_marginal(measurements: Measurements, station: Station) -> Predictor:
    """The same with the uncertainty of xi, beta and omega counted."""
    return marginalise(fit_channel(measurements, station).parameters, measurements).predict


def learn_path_loss(measurements: Measurements, station: Station) -> Predictor:
    """Path loss alone by least squares, with the deviation it leaves: what to beat."""
    identifiable = examine(measurements, station).n_pl_reason is None
    model = mean_model(measurements.positions_m, ~measurements.censored, station, identifiable)
    line = least_squares(model, measurements)
    theta = np.array(model.theta(line.coefficients))
    deviation_db = float(np.sqrt(line.variance_db2))

    def predict(positions_m: NDArray[np.float64]) -> Prediction:
        return Prediction(
            regressors(positions_m, station) @ theta, np.full(len(positions_m), deviation_db)
        )

    return predict


def held_out_predictions(
    measurements: Measurements,
    groups: NDArray[np.intp],
    learn: Callable[[Measurements], Predictor],
    folds: int,
    generator: np.random.Generator,
) -> Prediction:
    """Predict every measurement from a model learnt without its group.

    Parameters
    ----------
    measurements
        All of them.
    groups
        ``(n,)`` label of each one's group.
    learn
        Takes measurements and returns what predicts at positions.
    folds
        Groups are dealt into as many parts at random; a model is learnt without each.
    generator
        Source of randomness.

    Raises
    ------
    InputError
        There are fewer groups than folds, or fewer than two folds, or not a label a measurement.
    """
    labels, group_of = np.unique(groups, return_inverse=True)
    if groups.shape != (len(measurements),):
        raise InputError("there is not one group label a measurement", key="groups")
    if not 2 <= folds <= len(labels):
        raise InputError(
            f"{len(labels)} groups cannot be dealt into {folds} folds",
            key="folds",
            remedy="use at least 2 folds and no more than there are groups",
        )
    fold_of = (generator.permutation(len(labels)) % folds)[group_of]
    mean, deviation = np.empty(len(measurements)), np.empty(len(measurements))
    for fold in range(folds):
        out = fold_of == fold
        predict = learn(measurements.take(~out))
        prediction = predict(measurements.positions_m[out])
        mean[out], deviation[out] = prediction.mean_db, prediction.deviation_db
    return Prediction(mean, deviation)


def walk_groups(
    day: NDArray[np.float64], t_s: NDArray[np.float64], block_s: float
) -> NDArray[np.intp]:
    """Label walks: measurements of one day within one block of `block_s` seconds.

    Parameters
    ----------
    day, t_s
        ``(n,)`` day, and time in seconds within it.
    block_s
        Length of a block; ``inf`` for whole days.

    Raises
    ------
    InputError
        The block is not positive.
    """
    if not block_s > 0.0:
        raise InputError(f"{block_s!r} s is not a block", key="block_s", remedy="use more than 0")
    block = np.floor(t_s / block_s)
    return np.unique(np.stack([day, block], axis=1), axis=0, return_inverse=True)[1]
