"""Calibration of predictions: ratios of sums over groups, and reliability tables.

Powers of one walk, and steps of one run, are correlated. Intervals are therefore based on groups:
linearised variances of ratios as in cluster sampling, and Student's t with g - 1 degrees of freedom
for g groups. Intervals of a reliability table are those of Korn and Graubard for surveys ("Survey
Methodology" 24(2), 1998); if all outcomes of a bin are equal, the effective number of independent
outcomes is the number of groups.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.kriging import CONFIDENCE, binomial_interval
from planopt.errors import InputError


@dataclass(frozen=True)
class GroupedRatio:
    """Ratio of sums over groups with its confidence interval.

    Attributes
    ----------
    value
        Value of the ratio.
    low, high
        Bounds of the 95 % confidence interval, at least zero.
    """

    value: float
    low: float
    high: float

    def share(self) -> GroupedRatio:
        """Return the ratio as a share: the upper end of its interval is at most one."""
        return GroupedRatio(self.value, self.low, min(self.high, 1.0))

    def root(self) -> GroupedRatio:
        """Return the square root of ratio and interval: an RMSE for a mean squared error."""
        return GroupedRatio(math.sqrt(self.value), math.sqrt(self.low), math.sqrt(self.high))


def grouped_ratio(numerators: Floats, denominators: Floats) -> GroupedRatio:
    """Return the ratio of the sums of two quantities over groups.

    Parameters
    ----------
    numerators, denominators
        ``(g,)`` non-negative sums within each group: squared errors and their number for a mean
        squared error, numbers of powers inside an interval and of all powers for its coverage.

    Raises
    ------
    InputError
        There are fewer than two groups, or the denominators sum to zero.
    """
    groups, total = len(numerators), float(denominators.sum())
    if groups < 2 or total <= 0.0:
        raise InputError(
            f"the interval is undefined for {groups} groups with a total weight of {total:g}",
            remedy="give at least two groups with a positive weight",
        )
    ratio = float(numerators.sum()) / total
    half = float(stdtrit(groups - 1.0, 0.5 + 0.5 * CONFIDENCE))
    half *= _ratio_error(numerators, denominators)
    return GroupedRatio(ratio, max(ratio - half, 0.0), ratio + half)


def _ratio_error(numerators: Floats, denominators: Floats) -> float:
    """Return the linearised standard error of a ratio of sums over groups."""
    groups, total = len(numerators), float(denominators.sum())
    apart = numerators - float(numerators.sum()) / total * denominators
    return math.sqrt(groups / (groups - 1.0) * float(apart @ apart)) / total


EDGES = (0.0, 0.15, 0.35, 0.55, 0.75, 0.85, 0.925, 0.975, 0.995, 1.0)
"""Edges of the bins of predicted probability; the last bin includes 1."""
FEWEST_GROUPS = 5  # Minimum number of groups for a confidence interval


@dataclass(frozen=True)
class ReliabilityBin:
    """Bin of a reliability table: predicted probability and realised share."""

    low: float  # Range of the predicted probability
    high: float
    count: int  # Numbers of predictions and of groups
    groups: int
    predicted: float  # Mean predicted probability of connection
    realised: float  # Share that was connected
    # 95 % interval of `realised`; None for fewer than :data:`FEWEST_GROUPS` groups
    interval: tuple[float, float] | None

    @property
    def agrees(self) -> bool | None:
        """Return whether the bin's interval contains its mean prediction; None without interval."""
        if self.interval is None:
            return None
        return self.interval[0] <= self.predicted <= self.interval[1]


def reliability(
    predicted: Floats,  # (n,)
    realised: Mask,  # (n,)
    group_of: Indices,  # (n,)
) -> tuple[ReliabilityBin, ...]:
    """Return the bins of a reliability table that contain predictions, in ascending order."""
    if not predicted.shape == realised.shape == group_of.shape:
        raise InputError(
            f"there are {predicted.size} predictions, {realised.size} outcomes and "
            f"{group_of.size} group labels; these numbers should be equal"
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
    connected: Floats,  # (g,)
    sizes: Floats,  # (g,)
) -> tuple[float, float]:
    """Return Korn and Graubard's 95 % interval of the connected share over groups of `sizes`."""
    groups, count = len(sizes), float(sizes.sum())
    share = float(connected.sum()) / count
    variance = _ratio_error(connected, sizes) ** 2
    outcomes = float(groups) if variance == 0.0 else min(share * (1.0 - share) / variance, count)
    ordinary, few = np.asarray(stdtrit([max(count - 1.0, 1.0), groups - 1.0], 0.5 + CONFIDENCE / 2))
    outcomes *= float(ordinary / few) ** 2
    return binomial_interval(share * outcomes, outcomes)
