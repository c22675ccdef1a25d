# pyright: basic
"""Fits of xi, omega and beta to the empirical correlation of residuals (equations 2.2 to 2.5).

[GM11] averages products over pairs at *equal* distance. Distances between real positions never
repeat, so pairs are collected in bins of equal width, each at the mean distance of its pairs.
"""

import math
import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares as nonlinear_least_squares

from planopt.arrays import Floats
from planopt.channel.estimation.channel_fit import (
    CovarianceBounds,
    CovarianceFit,
    FitMethod,
    Loss,
    fallback_fit,
    from_correlation,
)
from planopt.channel.measurements import pairwise_distance_m

BINS = 100  # Number of bins over the extent
ROWS = 512  # Number of rows of the pair matrix in memory at once
LAG_CAP_SHARE = 0.25
"""Maximum lag of ``capped`` as a share of the extent, unless the correlation vanishes earlier."""
HUBER_DEVIATIONS = 1.345
"""Transition of Huber's loss in robust standard deviations, for an efficiency of 95 %."""
EFFICIENCY = {"huber": 0.95, "absolute": 2.0 / math.pi}
"""Efficiency of each loss relative to squares for normal residuals: the ratio of variances."""
NORMAL_MEDIAN = 0.6745  # Median absolute value of a standard normal variable
SCAN = 60
"""Number of values of beta, spaced geometrically, in the scan for the initial guess of ``nls``."""


@dataclass(frozen=True)
class EmpiricalCorrelation:
    """Empirical correlation of residuals in non-empty bins, by increasing lag."""

    lag_m: Floats  # (b,) mean distance of the bin's pairs
    covariance_db2: Floats  # (b,) mean product of the residuals, r-hat
    pairs: Floats  # (b,) number of pairs


def empirical_correlation(
    positions_m: Floats,  # (n, 2)
    residual_db: Floats,  # (n,)
    extent_m: float,
) -> EmpiricalCorrelation:
    """Return mean products of the residuals of pairs of measurements, binned by pair distance."""
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


def fit_correlation(
    correlation: EmpiricalCorrelation,
    alpha_db2: float,  # Total variance
    count: int,  # Number of measurements
    extent_m: float,
    bounds: CovarianceBounds,
    method: FitMethod,
    loss: Loss,
) -> CovarianceFit:
    """Estimate xi, beta and omega by one of the methods on binned correlations."""
    if alpha_db2 < bounds.shadow_db2[0]:
        return fallback_fit(alpha_db2, bounds.decorrelation_m, "the powers lie on the line")
    if method == "nls":
        return nls_fit(correlation, alpha_db2, count, bounds)
    bins = log_bins(correlation, alpha_db2, None if method == "lemma1" else extent_m)
    if len(bins.lag_m) < 2 or not np.ptp(bins.lag_m) > 0.0:
        reason = "fewer than two lags have a correlation between 0 and alpha"
        return fallback_fit(alpha_db2, bounds.decorrelation_m, reason)
    if method == "convex":
        return convex_fit(bins, alpha_db2, count, bounds, loss)
    return lemma1_fit(bins, alpha_db2, count, bounds)


@dataclass(frozen=True)
class LogBins:
    """Logarithms of binned correlations, to which a line is fitted."""

    lag_m: Floats  # (b,)
    log_covariance: Floats  # (b,) log r-hat
    weight: Floats  # (b,) tau


def log_bins(
    correlation: EmpiricalCorrelation, alpha_db2: float, extent_m: float | None = None
) -> LogBins:
    """Return the bins and weights of ``lemma1``, or of ``capped`` if `extent_m` is not None."""
    r, weight = correlation.covariance_db2, correlation.pairs
    keep = (r > 0.0) & (r < alpha_db2)
    if extent_m is not None:
        keep &= correlation.lag_m <= LAG_CAP_SHARE * extent_m
        weight = weight * (r / alpha_db2) ** 2
    return LogBins(correlation.lag_m[keep], np.log(r[keep]), weight[keep])


def lemma1_fit(
    bins: LogBins, alpha_db2: float, count: int, bounds: CovarianceBounds
) -> CovarianceFit:
    """Estimate xi, beta and omega by weighted least squares (equation 2.3)."""
    weight = bins.weight / bins.weight.sum()
    lag = bins.lag_m - weight @ bins.lag_m
    rate = -float((weight * lag) @ bins.log_covariance / (weight @ lag**2))
    intercept = float(weight @ (bins.log_covariance + rate * bins.lag_m))
    scatter = _scatter(bins, intercept, rate)
    errors = _line_errors(bins, intercept, float(scatter @ scatter))
    shadow = math.exp(min(intercept, 50.0))
    return from_correlation(shadow, rate, errors, alpha_db2, count, bounds)


def convex_fit(
    bins: LogBins, alpha_db2: float, count: int, bounds: CovarianceBounds, loss: Loss = "squares"
) -> CovarianceFit:
    """Fit xi, beta and omega by a line through `bins` that minimises a convex loss in `bounds`."""
    # With squared loss and no active bound, the result equals `lemma1_fit` on the same bins.
    if loss == "squares":
        intercept, rate = _convex_line(bins, alpha_db2, bounds, loss)
        scatter = _scatter(bins, intercept, rate)
        squares = float(scatter @ scatter)
    else:
        # Start with weights by numbers of pairs alone, as if the line were flat.
        flat = _weighed_by_line(bins, 0.0, 0.0)
        bins = _weighed_by_line(bins, *_convex_line(flat, alpha_db2, bounds))
        intercept, rate = _convex_line(bins, alpha_db2, bounds)
        # The two smallest residuals are left out of the median: the line passes through two bins.
        rest = np.sort(np.abs(_scatter(bins, intercept, rate)))[2:]
        deviation = float(np.median(rest)) / NORMAL_MEDIAN if len(rest) else 0.0
        if loss == "huber" and deviation > 0.0:
            turn = HUBER_DEVIATIONS * deviation
            intercept, rate = _convex_line(bins, alpha_db2, bounds, loss, turn)
        squares = len(bins.lag_m) * deviation**2 / EFFICIENCY[loss]
    errors = _line_errors(bins, intercept, squares)
    return from_correlation(math.exp(intercept), rate, errors, alpha_db2, count, bounds)


def nls_fit(
    correlation: EmpiricalCorrelation, alpha_db2: float, count: int, bounds: CovarianceBounds
) -> CovarianceFit:
    """Fit xi, beta and omega of the exponential to all bins by nonlinear least squares."""
    lag, share = correlation.lag_m, np.clip(correlation.covariance_db2 / alpha_db2, -1e3, 1e3)
    root = np.sqrt(correlation.pairs / correlation.pairs.sum())
    low, high = (math.log(end) for end in bounds.decorrelation_m)
    logs = np.linspace(low, high, SCAN)
    shapes = root * np.exp(-lag * np.exp(-logs)[:, None])
    norms = np.maximum((shapes**2).sum(axis=1), 1e-300)
    heights = np.clip((shapes * (root * share)).sum(axis=1) / norms, 0.0, 1.0)
    losses = ((heights[:, None] * shapes - root * share) ** 2).sum(axis=1)
    best = int(np.argmin(losses))

    def misfit(x):
        return root * (x[0] * np.exp(-lag * math.exp(-x[1])) - share)

    def jacobian(x):
        shape = root * np.exp(-lag * math.exp(-x[1]))
        return np.column_stack([shape, x[0] * lag * math.exp(-x[1]) * shape])

    x = np.array([heights[best], logs[best]])  # xi^2 / alpha, log beta
    if low < high:
        # The solver's initial guess has to be inside the box.
        box = np.array([0.0, low]), np.array([1.0, high])
        inside = np.clip(x, box[0] + 1e-6, box[1] - 1e-6 * (high - low))
        inside[1] = max(inside[1], low + 1e-6 * (high - low))
        found = nonlinear_least_squares(
            misfit,
            inside,
            jacobian,  # pyright: ignore[reportArgumentType]
            box,
            ftol=1e-14,
            xtol=1e-14,
            gtol=1e-14,
        )
        if 2.0 * found.cost <= losses[best]:
            x = found.x
    rate, slope = math.exp(-x[1]), jacobian(x)
    information, errors = slope.T @ slope, (math.inf, math.inf)
    if len(lag) >= 3 and np.linalg.cond(information) <= 1e14:
        # Residuals are assumed independent between bins.
        scatter = float((misfit(x) ** 2).sum()) / (len(lag) - 2)
        spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(information)) * scatter, 0.0))
        errors = float(spread[0]) * alpha_db2, float(spread[1]) * rate
    return from_correlation(float(x[0]) * alpha_db2, rate, errors, alpha_db2, count, bounds)


def _scatter(bins: LogBins, intercept: float, rate_per_m: float) -> Floats:
    """Return the residuals (b,) of a line, times the square roots of the normalised weights."""
    scatter = bins.log_covariance - intercept + rate_per_m * bins.lag_m
    return np.sqrt(bins.weight / bins.weight.sum()) * scatter


def _line_errors(bins: LogBins, intercept: float, squares: float) -> tuple[float, float]:
    """Return standard errors of xi^2 and of the line's rate; infinite for fewer than three bins."""
    # `squares` is the sum of squared residuals, which are assumed independent between bins.
    count = len(bins.lag_m)
    if count < 3:
        return math.inf, math.inf
    weight = bins.weight / bins.weight.sum()
    centre = float(weight @ bins.lag_m)
    spread = float(weight @ (bins.lag_m - centre) ** 2)
    # Kish's effective number, as bins of negligible weight do not count as observations.
    effective = max(1.0 / float(weight @ weight), 1.0)
    variance = squares * count / (count - 2) / effective
    return (
        math.exp(min(intercept, 50.0)) * math.sqrt(variance * (1.0 + centre**2 / spread)),
        math.sqrt(variance / spread),
    )


def _weighed_by_line(bins: LogBins, intercept: float, rate: float) -> LogBins:
    """Return the bins, weighted by number of pairs times squared correlation on the line."""
    above = intercept - rate * bins.lag_m - bins.log_covariance
    # Relative to the largest to avoid overflow; only ratios of weights matter.
    return replace(bins, weight=bins.weight * np.exp(2.0 * (above - above.max())))


def _convex_line(
    bins: LogBins,
    alpha_db2: float,
    bounds: CovarianceBounds,
    loss: Loss = "absolute",
    turn: float = 0.0,  # Residual at which Huber's loss becomes linear
) -> tuple[float, float]:
    """Return the bounded optimum (log xi^2, 1 / beta) of the convex fit."""
    import cvxpy as cp

    scale = float(bins.lag_m.max())
    root = np.sqrt(bins.weight / bins.weight.sum())
    a, b = cp.Variable(), cp.Variable()
    scatter = cp.multiply(root, bins.log_covariance - a + b * (bins.lag_m / scale))
    low, high = bounds.decorrelation_m
    least = bounds.shadow_db2[0]
    most = max(alpha_db2 - bounds.multipath_db2[0], least)
    constraints: list[cp.Constraint] = [
        a >= math.log(least),
        a <= math.log(most),
        b >= scale / high,
        b <= scale / low,
    ]
    if loss == "squares":
        total = cp.sum_squares(scatter)
    elif loss == "absolute":
        total = cp.norm1(scatter)
    else:
        # In units of `turn`, so that the solver's tolerances do not depend on it.
        total = cp.sum(cp.huber(scatter / turn))
    problem = cp.Problem(cp.Minimize(total), constraints)
    with warnings.catch_warnings():
        # CVXPY may warn of an inaccurate optimum, which still has eight digits here.
        warnings.simplefilter("ignore")
        problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    if a.value is None or b.value is None:
        raise AssertionError("a feasible, bounded convex programme has a solution")
    return float(np.clip(a.value, math.log(least), math.log(most))), float(b.value) / scale
