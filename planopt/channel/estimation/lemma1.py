"""Lemma 1 of [GM11]: a weighted line through the log of the empirical correlation (equation 2.3).

log r(d) = log xi^2 - d / beta, over the bins L = {d : 0 < r-hat(d) < alpha-hat}. As printed the
set keeps only the positive noise at long lags, which makes xi too small and beta too long however
many measurements there are. `capped` is the repair: lags up to a cap, and weights
n r^2, the inverse of the variance of log r-hat.

The empirical correlation of shadowing at binned lags, r-hat(d) of equation 2.2.

[GM11] averages products over pairs at *equal* distance. Distances between real positions never
repeat, so pairs are collected in bins of equal width, each standing at its pairs' mean distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.channel_fit import (
    CovarianceBounds,
    CovarianceFit,
    from_correlation,
)
from planopt.channel.measurement_covariance import pairwise_distance_m

BINS = 100
"""Bins over the extent."""

ROWS = 512
"""Rows of pairs that are held at once."""


@dataclass(frozen=True)
class EmpiricalCorrelation:
    """One entry a non-empty bin, by increasing lag."""

    lag_m: NDArray[np.float64]  # (b,) mean distance of the bin's pairs
    covariance_db2: NDArray[np.float64]  # (b,) mean product of the residuals, r-hat
    pairs: NDArray[np.float64]  # (b,) number of pairs


def empirical_correlation(
    positions_m: NDArray[np.float64], residual_db: NDArray[np.float64], extent_m: float
) -> EmpiricalCorrelation:
    """Average residual products of all pairs of distinct measurements, by lag."""
    # Shapes: positions_m, residual_db (n, 2).
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


LAG_CAP_SHARE = 0.25
"""`capped` uses lags up to this share of the extent, unless correlation vanishes earlier."""


@dataclass(frozen=True)
class LogBins:
    """The points that the line is fitted to: ``(b,)`` lags in m, log r-hat and weights tau."""

    lag_m: NDArray[np.float64]
    log_covariance: NDArray[np.float64]
    weight: NDArray[np.float64]


@dataclass(frozen=True)
class LogLine:
    """log r = intercept - rate d, and the standard errors of exp(intercept) and rate."""

    intercept: float
    rate_per_m: float
    errors: tuple[float, float]


def printed_bins(correlation: EmpiricalCorrelation, alpha_db2: float) -> LogBins:
    """Every bin of the printed set L, weighted by its number of pairs."""
    r = correlation.covariance_db2
    keep = (r > 0.0) & (r < alpha_db2)
    return LogBins(correlation.lag_m[keep], np.log(r[keep]), correlation.pairs[keep])


def capped_bins(correlation: EmpiricalCorrelation, alpha_db2: float, extent_m: float) -> LogBins:
    """The bins of L up to `LAG_CAP_SHARE` of the extent, weighted by n r^2."""
    r = correlation.covariance_db2
    keep = (r > 0.0) & (r < alpha_db2) & (correlation.lag_m <= LAG_CAP_SHARE * extent_m)
    weight = correlation.pairs[keep] * (r[keep] / alpha_db2) ** 2
    return LogBins(correlation.lag_m[keep], np.log(r[keep]), weight)


def log_line(bins: LogBins) -> LogLine:
    """The weighted least-squares line in closed form.

    The standard errors take the scatter about the line as independent between bins, which is
    optimistic; they are ``inf`` for two bins.
    """
    weight = bins.weight / bins.weight.sum()
    lag = bins.lag_m - weight @ bins.lag_m
    spread = weight @ lag**2
    mean = weight @ bins.log_covariance
    slope = float((weight * lag) @ bins.log_covariance / spread)
    intercept = float(mean - slope * (weight @ bins.lag_m))
    scatter = standardised_scatter(bins, intercept, -slope)
    return LogLine(intercept, -slope, line_errors(bins, intercept, float(scatter @ scatter)))


def standardised_scatter(bins: LogBins, intercept: float, rate_per_m: float) -> NDArray[np.float64]:
    """``(b,)`` sqrt(tau) (log r - intercept + rate d), tau of sum 1: of one variance each."""
    scatter = bins.log_covariance - intercept + rate_per_m * bins.lag_m
    return np.sqrt(bins.weight / bins.weight.sum()) * scatter


def line_errors(bins: LogBins, intercept: float, squares: float) -> tuple[float, float]:
    """Standard errors of xi^2 = exp(intercept) and of the rate.

    `squares` is the sum of squares of the standardised scatter.
    """
    count = len(bins.lag_m)
    if count < 3:
        return math.inf, math.inf
    weight = bins.weight / bins.weight.sum()
    centre = float(weight @ bins.lag_m)
    spread = float(weight @ (bins.lag_m - centre) ** 2)
    # Bins of weight near 0 do not count as observations: Kish's effective number.
    effective = max(1.0 / float(weight @ weight), 1.0)
    variance = squares * count / (count - 2) / effective
    return (
        math.exp(min(intercept, 50.0)) * math.sqrt(variance * (1.0 + centre**2 / spread)),
        math.sqrt(variance / spread),
    )


def enough(bins: LogBins) -> bool:
    """Return whether a line is determined: two bins at different lags."""
    return len(bins.lag_m) >= 2 and float(np.ptp(bins.lag_m)) > 0.0


def lemma1_fit(
    bins: LogBins, alpha_db2: float, count: int, bounds: CovarianceBounds
) -> CovarianceFit:
    """Estimate xi, beta and omega from the line (equation 2.3), brought within `bounds`."""
    line = log_line(bins)
    shadow = math.exp(min(line.intercept, 50.0))
    return from_correlation(shadow, line.rate_per_m, line.errors, alpha_db2, count, bounds)
