"""Grouped cross-validation of the channel against path loss alone and simple baselines.

Measurements next to training data are easy to predict, so whole groups, such as walks, are held
out. The probability integral transform (PIT) of held-out powers should be uniform. The PIT of a
censored power is spread uniformly between 0 and the PIT of its limit (Czado, Gneiting and Held,
Biometrics 65, 2009): dropping censored powers would bias the histogram. The baselines, which ignore
censored powers, are a least-squares line and a Gaussian process with a constant mean, an
exponential kernel and white noise, whose parameters maximise the marginal likelihood on a grid.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.calibration import GroupedRatio, ReliabilityBin, grouped_ratio, reliability
from planopt.channel.cholesky import log_determinant, lower_factor, one_blas_thread, solve_lower
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.least_squares import examine, least_squares, nearest_distance_m
from planopt.channel.estimation.reml import thinned
from planopt.channel.joint import predict_readings
from planopt.channel.kriging import Prediction, connection_probability
from planopt.channel.measurements import Measurements, Table, as_measurements, pairwise_distance_m
from planopt.channel.parameter_uncertainty import marginalise
from planopt.channel.parameters import Station, mean_model, regressors
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.short_repr import short_repr

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)  # Levels of the central prediction intervals

PIT_BINS = 20

Predictor = Callable[[Measurements], Prediction]
"""Function that predicts the powers of measurements without using their measured powers."""
PATH_LOSS = "path_loss"  # Name of the reference predictor
MARGINAL_EXACT_LIMIT = 1000
"""Maximum number of measurements for factors of the marginalised channel, which needs one for each
of its about 15 components. Beyond it the nearest measurements are used; on the campus logs, with
days held out, this raises the RMSE of the channel itself from 6.48 to 6.53 dB."""


def predictors_of(
    fit: Callable[[Measurements], ChannelFit],
) -> Callable[[Measurements], dict[str, Predictor]]:
    """Return a function that learns all compared predictors from training measurements.

    The predictors are the fitted channel, path loss alone and the baselines; `fit` is called once.
    """

    def learn(measurements: Measurements) -> dict[str, Predictor]:
        parameters = fit(measurements).parameters
        return {
            "channel": partial(predict_readings, condition(parameters, measurements)),
            # Includes the uncertainty of xi, beta and omega.
            "marginal": partial(
                predict_readings, marginalise(parameters, measurements, MARGINAL_EXACT_LIMIT)
            ),
            PATH_LOSS: learn_path_loss(measurements, parameters.station),
            "plain_line": learn_plain_line(measurements, parameters.station),
            "plain_process": learn_plain_process(measurements),
        }

    return learn


def learn_path_loss(measurements: Measurements, station: Station) -> Predictor:
    """Fit a predictor of path loss alone; the residuals give the standard deviation."""
    if measurements.censored.all():
        raise InputError(
            "the path loss cannot be fitted: all measurements are censored (upper limits)"
        )
    return _line_predictor(measurements, station)


LEAST_VARIANCE_DB2 = 1e-6


def learn_plain_line(measurements: Measurements, station: Station) -> Predictor:
    """Learn a line of power against log-distance from the uncensored powers."""
    exact = _uncensored(measurements)
    return _line_predictor(Measurements(exact.positions_m, exact.power_dbm), station, unbiased=True)


def _line_predictor(
    measurements: Measurements, station: Station, *, unbiased: bool = False
) -> Predictor:
    """Learn a least-squares line; `unbiased` selects the unbiased residual variance."""
    identifiable = examine(measurements, station).n_pl_reason is None
    model = mean_model(measurements.positions_m, ~measurements.censored, station, identifiable)
    line = least_squares(model, measurements)
    theta = np.array(model.theta(line.coefficients))
    variance = line.variance_db2
    if unbiased:
        count, columns = model.columns.shape
        variance = max(variance * count / max(count - columns, 1), LEAST_VARIANCE_DB2)
    deviation_db = math.sqrt(variance)

    def predict(readings: Measurements) -> Prediction:
        mean = regressors(readings.positions_m, station) @ theta
        return Prediction(mean, np.full(len(mean), deviation_db))

    return predict


MOST_LIKELIHOOD, MOST_CONDITIONED = 400, 4_000
"""Maximum numbers of powers in the likelihood and in the posterior, whose cost is cubic."""
FEWEST_PLACES = 6
"""Minimum number of distinct positions for a correlated process; with fewer it is white noise."""
LENGTHS, LOGITS = 7, (-3.0, -1.5, 0.0, 1.5, 3.0)
"""Grid of the search: number of length scales, and logits of the noise share."""
FINER = (-2.0 / 3.0, -1.0 / 3.0, 0.0, 1.0 / 3.0, 2.0 / 3.0)
"""Offsets of the refined grid from the best point, in steps of the first grid."""
Point = tuple[float, float]
"""Logarithm of the length scale in metres, and logit of the noise share."""


def learn_plain_process(measurements: Measurements) -> Predictor:
    """Learn a Gaussian process from the uncensored powers."""
    exact = _uncensored(measurements)
    exact = exact.take(thinned(len(exact), MOST_CONDITIONED))
    mean_db = float(exact.power_dbm.mean())
    centred = exact.power_dbm - mean_db
    some = thinned(len(exact), MOST_LIKELIHOOD)
    length_m, noise = math.inf, 1.0
    if len(np.unique(exact.positions_m[some], axis=0)) >= FEWEST_PLACES:
        length_m, noise = _most_likely(exact.positions_m[some], centred[some])
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
    """Return the uncensored measurements, sorted by position."""
    if measurements.censored.all():
        raise InputError(
            "the baseline predictor cannot be fitted: all measurements are censored (upper limits)"
        )
    placed = measurements.by_place()
    return placed.take(np.flatnonzero(~placed.censored))


def _correlation(distance_m: Floats, length_m: float, noise: float) -> Floats:
    """Return the correlation (n, n) of powers; `noise` is the variance share of white noise."""
    correlation = (1.0 - noise) * np.exp(-distance_m / length_m)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _most_likely(positions_m: Floats, centred_db: Floats) -> Point:
    """Return the most likely length scale and noise share, by a grid search."""
    distance_m = pairwise_distance_m(positions_m, positions_m)

    def likelihood(point: Point) -> float:
        """Return the log-likelihood at a point, with the variance profiled out."""
        lower = lower_factor(_correlation(distance_m, math.exp(point[0]), _logistic(point[1])))
        half = solve_lower(lower, centred_db)
        variance = max(float(half @ half) / len(half), LEAST_VARIANCE_DB2)
        return -0.5 * (len(half) * math.log(variance) + log_determinant(lower))

    def grid(logs: Iterable[float], logits: Iterable[float]) -> Point:
        return max(((float(log), logit) for log in logs for logit in logits), key=likelihood)

    extent_m = float(distance_m.max())
    nearest_m = float(np.median(nearest_distance_m(np.unique(positions_m, axis=0))))
    logs = np.linspace(math.log(min(nearest_m, extent_m) / 3.0), math.log(extent_m), LENGTHS)
    log, logit = grid(logs, LOGITS)
    steps = float(logs[1] - logs[0]), LOGITS[1] - LOGITS[0]
    log, logit = grid(
        [log + share * steps[0] for share in FINER], [logit + share * steps[1] for share in FINER]
    )
    return math.exp(log), _logistic(logit)


def _logistic(logit: float) -> float:
    return 1.0 / (1.0 + math.exp(-logit))


@dataclass(frozen=True)
class HeldOutScore:
    """Accuracy and calibration of one predictor on held-out measurements.

    Attributes
    ----------
    rmse_db
        Root mean squared error over the uncensored powers.
    of_path_loss
        Ratio of `rmse_db` to the RMSE of path loss alone on the same powers.
    coverage
        Share of powers within the central interval, by level; censored powers count fractionally.
    pit_share
        ``(b,)`` histogram of the PIT in bins of equal width; the shares sum to one.
    reliability
        Predicted probability and observed frequency of powers that reach the report's threshold.
        Censored powers with a limit at or above the threshold are left out.
    """

    rmse_db: GroupedRatio
    of_path_loss: GroupedRatio
    coverage: dict[float, GroupedRatio]
    pit_share: Floats
    reliability: tuple[ReliabilityBin, ...]


@dataclass(frozen=True)
class HeldOutReport:
    """Result of a grouped cross-validation.

    Attributes
    ----------
    groups
        Number of groups; each is held out as a whole.
    fold_sizes
        Number of measurements in each fold.
    measurements, censored
        Number of measurements, and of censored ones among them.
    threshold_dbm
        Minimum power for a connection.
    scores
        Scores by predictor, including `planopt.channel.held_out.PATH_LOSS`.
    """

    groups: int
    fold_sizes: tuple[int, ...]
    measurements: int
    censored: int
    threshold_dbm: float
    scores: dict[str, HeldOutScore]

    __repr__ = short_repr


@one_blas_thread()
def held_out_report(
    measurements: Measurements | Table,
    groups: Indices,
    fold_of: Indices,
    learn: Callable[[Measurements], Mapping[str, Predictor]],
    threshold_dbm: float | None = None,
) -> HeldOutReport:
    """Predict every fold from the other folds, and score the predictions.

    Parameters
    ----------
    measurements
        Measurements of all folds.
    groups
        ``(n,)`` group label of each measurement.
    fold_of
        ``(n,)`` fold of each measurement, from :func:`planopt.channel.held_out.deal`.
    learn
        Function that learns predictors from training measurements, from
        :func:`planopt.channel.predictors_of`. One of them must be ``path_loss``.
    threshold_dbm
        Minimum power for a connection; None for the median power.

    Raises
    ------
    InputError
        Shapes of measurements, groups and folds differ, a fit to the training measurements is
        impossible, or all measurements are censored.
    """
    data = as_measurements(measurements)
    if groups.shape != (len(data),):
        raise InputError(
            f"has {groups.size} labels, should have one for each of {len(data)} measurements",
            key="groups",
        )
    threshold = float(np.median(data.power_dbm)) if threshold_dbm is None else threshold_dbm
    predictions = held_out_predictions(data, fold_of, learn)
    labels, group_of = np.unique(groups, return_inverse=True)
    sizes, exact = _summed(1.0, group_of), _summed(~data.censored, group_of)
    edges = np.linspace(0.0, 1.0, PIT_BINS + 1).tolist()
    # A censored power with a limit above the threshold has an unknown outcome.
    known = ~data.censored | (data.power_dbm < threshold)

    def squares(prediction: Prediction) -> Floats:
        error = np.where(data.censored, 0.0, data.power_dbm - prediction.mean_db)
        return _summed(error**2, group_of)

    def score(prediction: Prediction) -> HeldOutScore:
        # The predictive distribution function at the measured power.
        error = data.power_dbm - prediction.mean_db
        pit = connection_probability(error, prediction.deviation_db, 0.0)
        inside = {
            level: part_between(pit, data.censored, 0.5 - 0.5 * level, 0.5 + 0.5 * level)
            for level in LEVELS
        }
        chance = connection_probability(prediction.mean_db, prediction.deviation_db, threshold)
        return HeldOutScore(
            grouped_ratio(squares(prediction), exact).root(),
            grouped_ratio(squares(prediction), squares(predictions[PATH_LOSS])).root(),
            {
                level: grouped_ratio(_summed(part, group_of), sizes).share()
                for level, part in inside.items()
            },
            np.array([part_between(pit, data.censored, *ends).mean() for ends in pairwise(edges)]),
            reliability(chance[known], data.power_dbm[known] >= threshold, group_of[known]),
        )

    return HeldOutReport(
        len(labels),
        tuple(int((fold_of == fold).sum()) for fold in np.unique(fold_of)),
        len(data),
        int(data.censored.sum()),
        threshold,
        {name: score(prediction) for name, prediction in predictions.items()},
    )


def _summed(values: Floats | Mask | float, group_of: Indices) -> Floats:
    """Return the sum of values (n,) within each group."""
    weights = np.broadcast_to(values, group_of.shape)
    return np.bincount(group_of, weights=weights).astype(np.float64)


def part_between(
    pit: Floats,  # (n,) PIT of each power, or of a censored power's limit
    censored: Mask,  # (n,)
    low: float,
    high: float,
) -> Floats:
    """Return the part (n,) of each PIT that lies in [low, high), or in [low, 1] if `high` is 1."""
    inside = (pit >= low) & ((pit < high) | (high >= 1.0))
    below = np.clip(pit, low, high) - low
    # A PIT of 0 lies entirely in the first interval.
    part = np.where(pit > 0.0, below / np.where(pit > 0.0, pit, 1.0), low <= 0.0)
    return np.where(censored, part, inside)


def held_out_predictions(
    measurements: Measurements,
    fold_of: Indices,  # (n,)
    learn: Callable[[Measurements], Mapping[str, Predictor]],
) -> dict[str, Prediction]:
    """Predict every measurement with predictors learnt from the other folds."""
    folds = np.unique(fold_of)
    if fold_of.shape != (len(measurements),) or len(folds) < 2:
        raise InputError(
            f"has {len(folds)} different folds for {len(measurements)} measurements",
            key="folds",
            remedy="give one fold number for each measurement, and at least two different ones",
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


def deal(groups: Indices, folds: int, generator: np.random.Generator) -> Indices:
    """Assign whole groups to folds at random; return the fold of each measurement, ``(n,)``.

    Parameters
    ----------
    groups
        ``(n,)`` group label of each measurement.
    folds
        Number of folds, from 2 to the number of groups.
    generator
        Random number generator.

    Raises
    ------
    InputError
        There are fewer groups than folds, or fewer than two folds.
    """
    labels, group_of = np.unique(groups, return_inverse=True)
    if not 2 <= folds <= len(labels):
        raise InputError(
            f"is {folds}, but there are {len(labels)} groups",
            key="folds",
            remedy="use at least 2 folds and at most as many as there are groups",
        )
    return (generator.permutation(len(labels)) % folds)[group_of]
