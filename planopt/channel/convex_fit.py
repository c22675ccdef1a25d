# pyright: basic
"""The log-domain fit as a constrained convex programme: the boundary to CVXPY and Clarabel.

In a = log xi^2 and b = 1 / beta the weighted squares of log r-hat - a + b d are convex, and so are
the physical constraints that the closed form ignores: xi^2 <= alpha-hat (omega^2 cannot be
negative) and beta within what the positions can tell.
"""

from __future__ import annotations

import math
import warnings

import numpy as np

from planopt.channel.covariance_fit import CovarianceBounds, CovarianceFit, from_correlation
from planopt.channel.lemma1 import LogBins, line_errors


def convex_fit(
    bins: LogBins, alpha_db2: float, count: int, bounds: CovarianceBounds
) -> CovarianceFit:
    """xi, beta and omega by ``min sum tau (log r - a + b d)^2`` within constraints.

    Equals :func:`planopt.channel.lemma1.lemma1_fit` on the same bins when no constraint binds.

    Parameters
    ----------
    bins
        From :func:`planopt.channel.lemma1.capped_bins`, at least two.
    alpha_db2, count
        alpha-hat, and the number of measurements behind it.
    bounds
        Of xi^2 (from below; from above xi^2 <= alpha - the least omega^2) and of beta.
    """
    import cvxpy as cp

    scale = float(bins.lag_m.max())
    root = np.sqrt(bins.weight / bins.weight.sum())
    a, b = cp.Variable(), cp.Variable()
    scatter = bins.log_covariance - a + b * (bins.lag_m / scale)
    low, high = bounds.decorrelation_m
    least = bounds.shadow_db2[0]
    most = max(alpha_db2 - bounds.multipath_db2[0], least)
    constraints: list[cp.Constraint] = [
        a >= math.log(least),
        a <= math.log(most),
        b >= scale / high,
        b <= scale / low,
    ]
    problem = cp.Problem(cp.Minimize(cp.sum_squares(cp.multiply(root, scatter))), constraints)
    with warnings.catch_warnings():
        # CVXPY warns of an inaccurate optimum; here that is still good to eight digits.
        warnings.simplefilter("ignore")
        problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    if a.value is None or b.value is None:
        raise AssertionError("a feasible, bounded quadratic programme has a solution")
    intercept = float(np.clip(a.value, math.log(least), math.log(most)))
    rate = float(b.value) / scale
    return from_correlation(
        math.exp(intercept), rate, line_errors(bins, intercept, rate), alpha_db2, count, bounds
    )
