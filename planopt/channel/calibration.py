"""Predictions against measurements that they have not seen: error, coverage, PIT, reliability.

A prediction is a normal distribution. Over many held-out powers its probability integral transform
(PIT), the share of the distribution below what was measured, should be uniform, and a central
interval of level p should contain a share p of them. A power that is only known to be at most its
value has no PIT of its own: it counts in parts, uniformly between 0 and the PIT of that value
(Czado, Gneiting and Held, Biometrics 65, 2009), so that leaving it out selects nothing.

Powers of one walk, and steps of one run, belong together: thousands of them may say no more than a
handful of independent ones. Intervals therefore count groups. The variance of a ratio of sums
follows from how the groups differ from it (the linearised ratio estimator of cluster sampling), and
Student's t with one degree of freedom less than groups allows for there being few.

A reliability table bins predictions by the predicted probability of connection and compares the
mean of each bin with the share that came true, with Korn and Graubard's interval for surveys of
clusters ("Confidence intervals for proportions with small expected number of positive counts
estimated from survey data", Survey Methodology 24(2), 1998): the variance of the share says how
many independent outcomes the bin is equivalent to, and the exact binomial interval of that number
follows. Unlike a bootstrap over groups, the interval has a width where every outcome is the same; a
bin of one outcome only is then equivalent to as many outcomes as groups.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.cholesky import one_blas_thread
from planopt.channel.held_out import PATH_LOSS, Predictor, held_out_predictions
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.prediction import (
    CONFIDENCE,
    Prediction,
    binomial_interval,
    bound_quantile,
    connection_probability,
)
from planopt.errors import InputError
from planopt.short_repr import short_repr

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)
"""Levels of the central intervals."""

PIT_BINS = 20


@dataclass(frozen=True)
class Coverage:
    """The share of held-out powers that a central interval contains."""

    level: float  # What it should contain, a share
    share: float  # What it contains
    # 95 % Wilson interval of `share`. It takes the powers for independent; those of one walk are
    # not, and the true interval is wider.
    low: float
    high: float


@dataclass(frozen=True)
class Calibration:
    """Predictions against what was then measured.

    Attributes
    ----------
    coverage
        One a level, in the order given.
    pit_edges, pit_share
        ``(b + 1,)`` and ``(b,)``: histogram of the PIT; shares sum to one.
    rmse_db
        Root mean squared error of the mean; NaN where everything is censored.
    count, censored
        Held-out measurements, and how many of them are only upper limits (these are not in
        `rmse_db`).
    """

    coverage: tuple[Coverage, ...]
    pit_edges: NDArray[np.float64]
    pit_share: NDArray[np.float64]
    rmse_db: float
    count: int
    censored: int

    __repr__ = short_repr


def calibrate(
    prediction: Prediction, held_out: Measurements, levels: Sequence[float] = LEVELS
) -> Calibration:
    """Compare predictions with measurements that they have not seen.

    Parameters
    ----------
    prediction
        At the positions of `held_out`, in its order.
    held_out
        At least one.
    levels
        Of the central intervals, between 0 and 1.

    Raises
    ------
    InputError
        There is nothing to compare, lengths differ, a deviation is not positive, or a level is not
        between 0 and 1.
    """
    count = len(held_out)
    if count == 0 or prediction.mean_db.shape != (count,):
        raise InputError(
            f"{prediction.mean_db.size} predictions and {count} measurements cannot be compared",
            remedy="predict at the held-out positions",
        )
    if not (prediction.deviation_db > 0.0).all():
        raise InputError("a predicted deviation is not positive")
    for level in levels:
        if not 0.0 < level < 1.0:
            raise InputError(f"{level!r} is not between 0 and 1", key="levels")
    censored, error = held_out.censored, held_out.power_dbm - prediction.mean_db
    # The probability that the predicted power is at most the measured one.
    upper = connection_probability(error, prediction.deviation_db, 0.0)
    edges = np.linspace(0.0, 1.0, PIT_BINS + 1)
    shares = [share_between(upper, censored, *ends) for ends in pairwise(edges.tolist())]
    coverage = tuple(
        _coverage(
            level, share_between(upper, censored, 0.5 - 0.5 * level, 0.5 + 0.5 * level), count
        )
        for level in levels
    )
    rmse_db = math.nan if censored.all() else float(np.sqrt(np.mean(error[~censored] ** 2)))
    return Calibration(coverage, edges, np.array(shares), rmse_db, count, int(censored.sum()))


def share_between(
    upper: NDArray[np.float64],  # (n,) PIT of each power, or of the limit of a censored one
    censored: NDArray[np.bool_],  # (n,)
    low: float,
    high: float,
) -> float:
    """Share of the PIT within [low, high); 1 belongs to the last interval."""
    inside = (upper >= low) & ((upper < high) | (high >= 1.0))
    below = np.clip(upper, low, high) - low
    # All of the limit's mass is below it, even where that is nothing.
    part = np.where(upper > 0.0, below / np.where(upper > 0.0, upper, 1.0), low <= 0.0)
    return float(np.where(censored, part, inside).mean())


def _coverage(level: float, share: float, count: int) -> Coverage:
    """A share with its Wilson interval."""
    z2 = bound_quantile(0.5 + 0.5 * CONFIDENCE) ** 2
    scale = 1.0 + z2 / count
    centre = (share + z2 / (2.0 * count)) / scale
    half = math.sqrt(z2 * (share * (1.0 - share) / count + z2 / (4.0 * count**2))) / scale
    return Coverage(level, share, max(centre - half, 0.0), min(centre + half, 1.0))


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
    groups, total = len(numerators), float(denominators.sum())
    if groups < 2 or total <= 0.0:
        raise InputError(
            f"{groups} groups of {total:g} in all give no interval",
            remedy="give two groups or more that have something in them",
        )
    ratio = float(numerators.sum()) / total
    half = float(stdtrit(groups - 1.0, 0.5 + 0.5 * CONFIDENCE))
    half *= _ratio_error(numerators, denominators)
    return GroupedRatio(ratio, max(ratio - half, 0.0), ratio + half)


def _ratio_error(numerators: NDArray[np.float64], denominators: NDArray[np.float64]) -> float:
    """The linearised standard error of a ratio of sums over two groups or more."""
    groups, total = len(numerators), float(denominators.sum())
    apart = numerators - float(numerators.sum()) / total * denominators
    return math.sqrt(groups / (groups - 1.0) * float(apart @ apart)) / total


EDGES = (0.0, 0.15, 0.35, 0.55, 0.75, 0.85, 0.925, 0.975, 0.995, 1.0)
"""Of the bins of predicted probability; the last one includes its upper end. No bin begins or ends
at a probability that problems usually require, since plans keep these to the last digit."""

FEWEST_GROUPS = 5
"""Fewer groups give no interval."""


@dataclass(frozen=True)
class ReliabilityBin:
    """Predictions of similar probability, and what came of them."""

    low: float  # Range of the predicted probability
    high: float
    count: int  # How many predictions, and of how many groups
    groups: int
    predicted: float  # Mean predicted probability of connection
    realised: float  # Share that was connected
    # 95 % interval of `realised`; None for fewer than :data:`FEWEST_GROUPS` groups
    interval: tuple[float, float] | None

    @property
    def agrees(self) -> bool | None:
        """Return whether the interval holds the mean prediction; None without an interval."""
        if self.interval is None:
            return None
        return self.interval[0] <= self.predicted <= self.interval[1]


def reliability(
    predicted: NDArray[np.float64],  # (n,)
    realised: NDArray[np.bool_],  # (n,)
    group_of: NDArray[np.intp],  # (n,)
) -> tuple[ReliabilityBin, ...]:
    """Tabulate predicted against realised connection."""
    if not predicted.shape == realised.shape == group_of.shape:
        raise InputError(
            f"{predicted.size} predictions, {realised.size} outcomes and {group_of.size} groups "
            "cannot be compared"
        )
    bins: list[ReliabilityBin] = []
    for low, high in pairwise(EDGES):
        inside = (predicted >= low) & ((predicted < high) | (high == 1.0))
        if not inside.any():
            continue
        labels, number = np.unique(group_of[inside], return_inverse=True)
        sizes = np.bincount(number).astype(np.float64)
        connected = np.bincount(number, weights=realised[inside]).astype(np.float64)
        bins.append(
            ReliabilityBin(
                low,
                high,
                count=int(inside.sum()),
                groups=len(labels),
                predicted=float(predicted[inside].mean()),
                realised=float(connected.sum() / sizes.sum()),
                interval=share_interval(connected, sizes) if len(labels) >= FEWEST_GROUPS else None,
            )
        )
    return tuple(bins)


def share_interval(
    connected: NDArray[np.float64],  # (g,)
    sizes: NDArray[np.float64],  # (g,)
) -> tuple[float, float]:
    """Return Korn and Graubard's 95 % interval of a share."""
    groups, count = len(sizes), float(sizes.sum())
    share = float(connected.sum()) / count
    variance = _ratio_error(connected, sizes) ** 2
    outcomes = float(groups) if variance == 0.0 else min(share * (1.0 - share) / variance, count)
    ordinary, few = np.asarray(stdtrit([max(count - 1.0, 1.0), groups - 1.0], 0.5 + CONFIDENCE / 2))
    outcomes *= float(ordinary / few) ** 2
    return binomial_interval(share * outcomes, outcomes)


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
        By level, share of powers within the central interval; upper limits count in parts.
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
        By predictor; `planopt.channel.held_out.PATH_LOSS` is one of them.
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
        ``(n,)`` fold of each, as :func:`planopt.channel.held_out.deal` gives it.
    learn
        Learns predictors, as :func:`planopt.channel.predictors_of` makes it; path loss among them.
    threshold_dbm
        A power of at least this counts as connected; None for the median power, so that half of
        them are.

    Raises
    ------
    InputError
        Measurements, groups and folds do not belong together; a fit of a part of the measurements
        is impossible; or there are upper limits only.
    """
    data = as_measurements(measurements)
    if groups.shape != (len(data),):
        raise InputError("there is not one group label a measurement", key="groups")
    threshold = float(np.median(data.power_dbm)) if threshold_dbm is None else threshold_dbm
    predictions = held_out_predictions(data, fold_of, learn)
    labels, group_of = np.unique(groups, return_inverse=True)
    members = [np.flatnonzero(group_of == group) for group in range(len(labels))]
    sizes = np.bincount(group_of).astype(np.float64)
    exact = np.bincount(group_of, weights=~data.censored).astype(np.float64)
    # Whether a power reaches the threshold is unknown for a limit above it.
    known = ~data.censored | (data.power_dbm < threshold)

    def squares(prediction: Prediction) -> NDArray[np.float64]:
        """Squared errors of powers that are not upper limits, summed by group."""
        error = np.where(data.censored, 0.0, data.power_dbm - prediction.mean_db)
        return np.bincount(group_of, weights=error**2).astype(np.float64)

    def score(prediction: Prediction) -> HeldOutScore:
        parts = [calibrate(prediction.at(rows), data.take(rows)) for rows in members]
        inside = sizes[:, None] * [[one.share for one in part.coverage] for part in parts]
        chance = connection_probability(prediction.mean_db, prediction.deviation_db, threshold)
        return HeldOutScore(
            grouped_ratio(squares(prediction), exact).root(),
            grouped_ratio(squares(prediction), squares(predictions[PATH_LOSS])).root(),
            {level: _share(column, sizes) for level, column in zip(LEVELS, inside.T, strict=True)},
            calibrate(prediction, data),
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


def _share(inside: NDArray[np.float64], sizes: NDArray[np.float64]) -> GroupedRatio:
    """A share, whose interval ends at one."""
    found = grouped_ratio(inside, sizes)
    return GroupedRatio(found.value, found.low, min(found.high, 1.0))
