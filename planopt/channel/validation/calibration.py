"""Calibration of predictions: coverage, PIT and error on held-out measurements.

A prediction is a normal distribution. Over many held-out powers its probability integral transform
(PIT), the share of the distribution below what was measured, should be uniform, and a central
interval of level p should contain a share p of them. A power that is only known to be at most its
value has no PIT of its own: it counts in parts, uniformly between 0 and the PIT of that value
(Czado, Gneiting and Held, Biometrics 65, 2009), so that leaving it out selects nothing.

Predicted against realised connection: a reliability table with intervals by group.

Predictions are binned by the probability that was predicted, and each bin compares its mean with
the share that came true. Steps of one run belong together, as do powers of one walk, so that the
interval of a share counts groups: Korn and Graubard's interval for surveys of clusters ("Confidence
intervals for proportions with small expected number of positive counts estimated from survey data",
Survey Methodology 24(2), 1998). The variance of the share is that of cluster sampling
(:mod:`planopt.channel.validation.held_out`); it says how many independent outcomes the bin is
worth, with Student's quantile for there being few groups, and the exact binomial interval (Clopper
and Pearson) of that number follows. Unlike a bootstrap over groups, the interval has a width where
every outcome is the same; a bin of one outcome only is then worth as many outcomes as groups.

Bins do not begin or end at probabilities that a problem usually asks for, since plans keep these to
the last digit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.measurements import Measurements
from planopt.channel.prediction import Prediction, connection_probability
from planopt.channel.validation.held_out import LEVEL, ratio_error
from planopt.errors import InputError
from planopt.short_repr import short_repr

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)
"""Levels of the central intervals."""

PIT_BINS = 20

BINOMIAL_Z = 1.959964
"""Coverage has a 95 % interval."""


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
    # The probability that the predicted power is at most the measured one.
    upper = connection_probability(
        held_out.power_dbm - prediction.mean_db, prediction.deviation_db, 0.0
    )
    edges = np.linspace(0.0, 1.0, PIT_BINS + 1)
    shares = np.array(
        [
            share_between(upper, held_out.censored, low, high)
            for low, high in pairwise(edges.tolist())
        ]
    )
    exact = ~held_out.censored
    error = (held_out.power_dbm - prediction.mean_db)[exact]
    return Calibration(
        tuple(
            _coverage(
                level,
                share_between(upper, held_out.censored, 0.5 - 0.5 * level, 0.5 + 0.5 * level),
                count,
            )
            for level in levels
        ),
        edges,
        shares,
        float(np.sqrt(np.mean(error**2))) if exact.any() else math.nan,
        count,
        int(held_out.censored.sum()),
    )


def share_between(
    upper: NDArray[np.float64], censored: NDArray[np.bool_], low: float, high: float
) -> float:
    """Share of the PIT within [low, high); 1 belongs to the last interval."""
    # Shapes: upper (n,); censored (n,).
    inside = (upper >= low) & ((upper < high) | (high >= 1.0))
    below = np.clip(upper, low, high) - low
    # All of the limit's mass is below it, even where that is nothing.
    part = np.where(upper > 0.0, below / np.where(upper > 0.0, upper, 1.0), low <= 0.0)
    return float(np.where(censored, part, inside).mean())


def _coverage(level: float, share: float, count: int) -> Coverage:
    """A share with its Wilson interval."""
    z2 = BINOMIAL_Z**2
    centre = (share + z2 / (2.0 * count)) / (1.0 + z2 / count)
    half = (
        BINOMIAL_Z
        / (1.0 + z2 / count)
        * math.sqrt(share * (1.0 - share) / count + z2 / (4.0 * count**2))
    )
    return Coverage(level, share, max(centre - half, 0.0), min(centre + half, 1.0))


EDGES = (0.0, 0.15, 0.35, 0.55, 0.75, 0.85, 0.925, 0.975, 0.995, 1.0)
"""Of the bins of predicted probability; the last one includes its upper end."""

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
    predicted: NDArray[np.float64], realised: NDArray[np.bool_], group_of: NDArray[np.intp]
) -> tuple[ReliabilityBin, ...]:
    """Tabulate predicted against realised connection."""
    # Shapes: predicted (n,); realised (n,); group_of (n,).
    if not predicted.shape == realised.shape == group_of.shape:
        raise InputError(
            f"{predicted.size} predictions, {realised.size} outcomes and {group_of.size} groups "
            "cannot be compared"
        )
    bins: list[ReliabilityBin] = []
    for low, high in pairwise(EDGES):
        inside = (predicted >= low) & ((predicted < high) | (high == 1.0))
        if inside.any():
            bins.append(_bin((low, high), predicted[inside], realised[inside], group_of[inside]))
    return tuple(bins)


def _bin(
    edges: tuple[float, float],
    predicted: NDArray[np.float64],
    realised: NDArray[np.bool_],
    group_of: NDArray[np.intp],
) -> ReliabilityBin:
    """One bin, with at least one prediction."""
    labels, number = np.unique(group_of, return_inverse=True)
    sizes = np.bincount(number).astype(np.float64)
    connected = np.bincount(number, weights=realised).astype(np.float64)
    return ReliabilityBin(
        *edges,
        count=len(predicted),
        groups=len(labels),
        predicted=float(predicted.mean()),
        realised=float(connected.sum() / sizes.sum()),
        interval=share_interval(connected, sizes) if len(labels) >= FEWEST_GROUPS else None,
    )


def share_interval(
    connected: NDArray[np.float64], sizes: NDArray[np.float64]
) -> tuple[float, float]:
    """Return Korn and Graubard's 95 % interval of a share."""
    # Shapes: connected (g,); sizes (g,).
    groups, count = len(sizes), float(sizes.sum())
    share = float(connected.sum()) / count
    variance = ratio_error(connected, sizes) ** 2
    worth = float(groups) if variance == 0.0 else min(share * (1.0 - share) / variance, count)
    ordinary, few = np.asarray(stdtrit([max(count - 1.0, 1.0), groups - 1.0], 0.5 + LEVEL / 2))
    worth *= float(ordinary / few) ** 2
    return _binomial_interval(share * worth, worth)


def _binomial_interval(successes: float, trials: float) -> tuple[float, float]:
    """Clopper and Pearson's interval; neither number need be whole."""
    failures, tail = trials - successes, 0.5 - LEVEL / 2
    low = 0.0 if successes <= 0.0 else float(betaincinv(successes, failures + 1.0, tail))
    high = 1.0 if failures <= 0.0 else float(betaincinv(successes + 1.0, failures, 1.0 - tail))
    return low, high
