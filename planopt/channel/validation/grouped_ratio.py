"""A ratio of sums over independent groups, with an interval that counts groups, not members.

Errors within one walk, or within one map, belong together: thousands of them may tell no more than
a handful of independent ones. The variance of a ratio of sums follows from how the groups differ
from it (the linearised ratio estimator of cluster sampling), and Student's t with one degree of
freedom less than groups allows for there being few. With few groups of unequal size the interval
is still a rough one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.errors import InputError

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
