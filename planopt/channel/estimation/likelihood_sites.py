"""Intervals beside Gaussian measurements: the sites that stand for them, the likelihood of all."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import log_determinant, lower_factor, solve_lower
from planopt.channel.estimation.likelihood_data import LikelihoodData
from planopt.channel.intervals.expectation_propagation import interval_sites
from planopt.channel.intervals.sites import (
    Intervals,
    IntervalSites,
    LatentPrior,
    rounded_variance_db2,
)


def sites_and_likelihood(
    data: LikelihoodData,
    latent_covariance: NDArray[np.float64],
    nugget: float,
    start: IntervalSites | None,
    tolerance: float,
) -> tuple[IntervalSites, float]:
    """Sites of the intervals given the Gaussian measurements, and log L of all.

    Parameters
    ----------
    data
        Measurements, some of them intervals.
    latent_covariance
        ``(n, n)`` V without multipath and rounding.
    nugget
        omega^2.
    start
        Sites of a point near by.
    tolerance
        Of :func:`planopt.channel.intervals.expectation_propagation.interval_sites`.
    """
    exact, width = data.exact, data.width_db[data.exact :]
    rounded = np.isfinite(width)
    known = Intervals(data.power_db[exact:] + np.where(rounded, 0.5 * width, 0.0), width)
    prior, exact_log_likelihood = _interval_prior(data, latent_covariance, nugget)
    sites = interval_sites(prior, known, nugget, start, tolerance)
    return sites, exact_log_likelihood + sites.log_evidence - float(np.log(width[rounded]).sum())


def _interval_prior(
    data: LikelihoodData, latent_covariance: NDArray[np.float64], nugget: float
) -> tuple[LatentPrior, float]:
    """What the Gaussian measurements, any number, say of the others and of theta; their log L.

    Theta has a flat prior. Where rounded ones may be needed to determine it, it is counted from the
    least-squares line, and the log likelihood is at that line: the rest of its integral over theta
    is in the prior's score and information.
    """
    exact, columns = data.exact, data.columns
    limits_only = bool(np.isinf(data.width_db[exact:]).all())
    line = np.zeros(columns.shape[1]) if limits_only else _least_squares_line(data)
    mean, left = columns[exact:] @ line, columns[exact:]
    covariance = latent_covariance[exact:, exact:]
    count = len(line)
    if not exact:
        return LatentPrior(mean, covariance, left, np.zeros((count, count)), np.zeros(count)), 0.0
    total = latent_covariance[:exact, :exact].copy()
    total[np.diag_indices(exact)] += nugget + rounded_variance_db2(data.width_db[:exact])
    lower = lower_factor(total)
    half_columns = solve_lower(lower, columns[:exact])
    half_residual = solve_lower(lower, data.power_db[:exact] - columns[:exact] @ line)
    half_cross = solve_lower(lower, latent_covariance[:exact, exact:])
    score: NDArray[np.float64] = half_columns.T @ half_residual
    prior = LatentPrior(
        mean + half_cross.T @ half_residual,
        covariance - half_cross.T @ half_cross,
        left - half_cross.T @ half_columns,
        half_columns.T @ half_columns,
        score,
    )
    squares = float(half_residual @ half_residual)
    at_line = -0.5 * (log_determinant(lower) + squares + exact * math.log(2.0 * math.pi))
    if not limits_only:
        return prior, at_line
    integrated, log_integral = prior.integrated()
    return integrated, at_line + log_integral


def _least_squares_line(data: LikelihoodData) -> NDArray[np.float64]:
    """Coefficients of the mean by least squares of all but the limits; (p,)."""
    measured = np.isfinite(data.width_db)
    found = np.linalg.lstsq(data.columns[measured], data.power_db[measured], rcond=None)
    return np.asarray(found[0], dtype=np.float64)
