"""The empirical correlation of shadowing at binned lags, r-hat(d) of equation 2.2.

[GM11] averages products over pairs at *equal* distance. Distances between real positions never
repeat, so pairs are collected in bins of equal width, each standing at its pairs' mean distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kernel import pairwise_distance_m

BINS = 100
"""Bins over the extent."""

ROWS = 512
"""Rows of pairs that are held at once."""


@dataclass(frozen=True)
class EmpiricalCorrelation:
    """One entry a non-empty bin, by increasing lag.

    Attributes
    ----------
    lag_m
        ``(b,)`` mean distance of the bin's pairs.
    covariance_db2
        ``(b,)`` mean product of the residuals, r-hat.
    pairs
        ``(b,)`` number of pairs.
    """

    lag_m: NDArray[np.float64]
    covariance_db2: NDArray[np.float64]
    pairs: NDArray[np.float64]


def empirical_correlation(
    positions_m: NDArray[np.float64], residual_db: NDArray[np.float64], extent_m: float
) -> EmpiricalCorrelation:
    """Average residual products of all pairs of distinct measurements, by lag.

    Parameters
    ----------
    positions_m, residual_db
        ``(n, 2)`` and ``(n,)``.
    extent_m
        Diagonal of the bounding box; no pair is farther apart.
    """
    width = extent_m / BINS
    count = len(residual_db)
    totals = np.zeros((3, BINS + 1))
    for first in range(0, count, ROWS):
        last = min(first + ROWS, count)
        distance = pairwise_distance_m(positions_m[first:last], positions_m[first:])
        later = np.arange(first, count)[None, :] > np.arange(first, last)[:, None]
        product = residual_db[first:last, None] * residual_db[None, first:]
        bins = np.minimum((distance[later] / width).astype(np.intp), BINS)
        for row, weights in enumerate((None, distance[later], product[later])):
            totals[row] += np.bincount(bins, weights, BINS + 1)
    pairs, lag, covariance = totals[:, totals[0] > 0]
    return EmpiricalCorrelation(lag / pairs, covariance / pairs, pairs)
