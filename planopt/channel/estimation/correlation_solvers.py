# pyright: basic
"""Fits of the binned correlation by optimisation: the boundary to CVXPY and CasADi.

``convex``: in a = log xi^2 and b = 1 / beta the weighted loss of log r-hat - a + b d is convex, and
so are the physical constraints that the closed form ignores: xi^2 <= alpha-hat (omega^2 cannot be
negative) and beta within what the positions can tell.

``nls``: the exponential fitted to the correlation itself. Without the logarithm, bins whose
correlation came out negative count too, so nothing is selected and the bias of Lemma 1 does not
arise (equation 2.5). The problem is not convex in beta: a scan over beta, in which xi^2 is linear,
gives the start, and IPOPT refines it.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.channel_fit import (
    CovarianceBounds,
    CovarianceFit,
    Loss,
    from_correlation,
)
from planopt.channel.estimation.lemma1 import (
    EmpiricalCorrelation,
    LogBins,
    line_errors,
    standardised_scatter,
)

HUBER_DEVIATIONS = 1.345
"""Huber's loss turns from squares to absolute values at so many robust deviations of the scatter:
95 % as efficient as squares where the scatter is normal."""

EFFICIENCY = {"huber": 0.95, "absolute": 2.0 / math.pi}
"""Variance of the squares' estimate over that of the loss's, for normal scatter."""

NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal."""


def convex_fit(
    bins: LogBins,
    alpha_db2: float,
    count: int,
    bounds: CovarianceBounds,
    loss: Loss = "squares",
) -> CovarianceFit:
    """xi, beta and omega by ``min sum rho(sqrt(tau) (log r - a + b d))`` within constraints.

    With squares it equals :func:`planopt.channel.estimation.lemma1.lemma1_fit` on the same bins
    when no constraint binds.
    """
    if loss == "squares":
        intercept, rate = _line(bins, alpha_db2, bounds, loss)
        scatter = standardised_scatter(bins, intercept, rate)
        squares = float(scatter @ scatter)
    else:
        # First by numbers of pairs alone, as if the line were flat.
        bins = _weighed_by_line(bins, *_line(_weighed_by_line(bins, 0.0, 0.0), alpha_db2, bounds))
        intercept, rate = _line(bins, alpha_db2, bounds)
        deviation = _robust_deviation(standardised_scatter(bins, intercept, rate))
        if loss == "huber" and deviation > 0.0:
            turn = HUBER_DEVIATIONS * deviation
            intercept, rate = _line(bins, alpha_db2, bounds, loss, turn)
        squares = len(bins.lag_m) * deviation**2 / EFFICIENCY[loss]
    return from_correlation(
        math.exp(intercept), rate, line_errors(bins, intercept, squares), alpha_db2, count, bounds
    )


def _weighed_by_line(bins: LogBins, intercept: float, rate: float) -> LogBins:
    """Weights n r^2 with the line's r instead of each bin's own."""
    above = intercept - rate * bins.lag_m - bins.log_covariance
    # Relative to the largest, so that nothing overflows; only ratios of weights count.
    return replace(bins, weight=bins.weight * np.exp(2.0 * (above - above.max())))


def _line(
    bins: LogBins,
    alpha_db2: float,
    bounds: CovarianceBounds,
    loss: Loss = "absolute",
    turn: float = 0.0,
) -> tuple[float, float]:
    """The constrained optimum (log xi^2, 1 / beta); `turn` is where Huber's loss turns."""
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
        # In units of the turn, so that the solver's tolerances do not depend on it.
        total = cp.sum(cp.huber(scatter / turn))
    problem = cp.Problem(cp.Minimize(total), constraints)
    with warnings.catch_warnings():
        # CVXPY warns of an inaccurate optimum; here that is still good to eight digits.
        warnings.simplefilter("ignore")
        problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    if a.value is None or b.value is None:
        raise AssertionError("a feasible, bounded convex programme has a solution")
    return float(np.clip(a.value, math.log(least), math.log(most))), float(b.value) / scale


def _robust_deviation(scatter: NDArray[np.float64]) -> float:
    """Median absolute scatter as a normal's deviation, 0 for two bins.

    Without the two least: a line of least absolute values passes through two bins.
    """
    rest = np.sort(np.abs(scatter))[2:]
    return float(np.median(rest)) / NORMAL_MEDIAN if len(rest) else 0.0


SCAN = 60
"""Values of beta that are tried for the start, spaced geometrically."""

IPOPT_OPTIONS = {
    "print_time": False,
    "calc_lam_p": False,
    "show_eval_warnings": False,
    "error_on_fail": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-10,
    "ipopt.max_iter": 200,
}


def nls_fit(
    correlation: EmpiricalCorrelation, alpha_db2: float, count: int, bounds: CovarianceBounds
) -> CovarianceFit:
    """xi, beta and omega by ``min sum n (xi^2 exp(-d / beta) - r)^2`` over all bins."""
    import casadi as ca

    share = np.clip(correlation.covariance_db2 / alpha_db2, -1e3, 1e3)
    weight = correlation.pairs / correlation.pairs.sum()
    low, high = bounds.decorrelation_m
    betas = np.geomspace(low, high, SCAN)
    shapes = np.exp(-correlation.lag_m[None, :] / betas[:, None])
    norms = np.maximum((weight * shapes**2).sum(axis=1), 1e-300)
    heights = np.clip((weight * shapes * share).sum(axis=1) / norms, 0.0, 1.0)
    losses = (weight * (heights[:, None] * shapes - share) ** 2).sum(axis=1)
    best = int(np.argmin(losses))
    x = ca.SX.sym("x", 2)  # xi^2 / alpha, log beta
    misfit = x[0] * ca.exp(-correlation.lag_m / ca.exp(x[1])) - share
    solver = ca.nlpsol("nls", "ipopt", {"x": x, "f": ca.sum1(weight * misfit**2)}, IPOPT_OPTIONS)
    lower, upper = [0.0, math.log(low)], [1.0, math.log(high)]
    found = solver(x0=[heights[best], math.log(betas[best])], lbx=lower, ubx=upper)
    height, log_beta = np.clip(np.asarray(found["x"]).ravel(), lower, upper)
    # A polish that failed or got worse is not believed; the scan's best is near enough.
    if not float(found["f"]) <= losses[best]:
        height, log_beta = heights[best], math.log(betas[best])
    rate = math.exp(-log_beta)
    errors = _errors(correlation, weight, share, height, rate)
    return from_correlation(
        height * alpha_db2, rate, (errors[0] * alpha_db2, errors[1]), alpha_db2, count, bounds
    )


def _errors(
    correlation: EmpiricalCorrelation, weight, share, height: float, rate: float
) -> tuple[float, float]:
    """Standard errors of height and rate from the scatter, taken as independent between bins."""
    bins = len(share)
    shape = np.exp(-correlation.lag_m * rate)
    slope = np.stack([shape, -height * correlation.lag_m * shape], axis=1)
    information = slope.T @ (weight[:, None] * slope)
    if bins < 3 or np.linalg.cond(information) > 1e14:
        return math.inf, math.inf
    scatter = float(weight @ (height * shape - share) ** 2) / (bins - 2)
    variances = np.diag(np.linalg.inv(information)) * scatter
    return math.sqrt(max(variances[0], 0.0)), math.sqrt(max(variances[1], 0.0))
