# pyright: basic
"""The exponential fitted to the empirical correlation as it is: the boundary to CasADi and IPOPT.

Without the logarithm, bins whose correlation came out negative count too, so nothing is selected
and the bias of Lemma 1 does not arise (equation 2.5). The problem is not convex in beta: a scan
over beta, in which xi^2 is linear, gives the start, and IPOPT polishes.
"""

from __future__ import annotations

import math

import numpy as np

from planopt.channel.estimation.covariance_fit import (
    CovarianceBounds,
    CovarianceFit,
    from_correlation,
)
from planopt.channel.estimation.lemma1 import EmpiricalCorrelation

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
