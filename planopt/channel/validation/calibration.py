"""How far predictions can be believed: coverage, PIT and error on held-out measurements.

A prediction is a normal distribution. Over many held-out powers its probability integral transform
(PIT), the share of the distribution below what was measured, should be uniform, and a central
interval of level p should contain a share p of them. A power that is only known to be at most its
value has no PIT of its own: it counts in parts, uniformly between 0 and the PIT of that value
(Czado, Gneiting and Held, Biometrics 65, 2009), so that leaving it out selects nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
from planopt.channel.measurements import Measurements
from planopt.channel.prediction import Prediction
from planopt.errors import InputError
from planopt.short_repr import short_repr

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)
"""Levels of the central intervals."""

PIT_BINS = 20

BINOMIAL_Z = 1.959964
"""Coverage has a 95 % interval."""


@dataclass(frozen=True)
class Coverage:
    """How many held-out powers a central interval contains.

    Attributes
    ----------
    level
        What it should contain, a share.
    share
        What it contains.
    low, high
        95 % Wilson interval of `share`. It takes the powers for independent; those of one walk are
        not, and the true interval is wider.
    """

    level: float
    share: float
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
    """Share of the PIT within [low, high); 1 belongs to the last interval.

    Parameters
    ----------
    upper
        ``(n,)`` PIT of the measured value.
    censored
        ``(n,)`` where the PIT is somewhere between 0 and `upper`.
    low, high
        Ends of the interval.
    """
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
