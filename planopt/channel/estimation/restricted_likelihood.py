"""The restricted likelihood of xi^2, omega^2 and beta, with gradient, of intervals too.

Of exact measurements, with V = xi^2 exp(-d / beta) + omega^2 I and P = V^-1 - V^-1 G M G' V^-1,
M = (G' V^-1 G)^-1 (equations 2.6 and 2.7):

    log L = -(log |V| + log |G' V^-1 G| + y' P y + (n - p) log 2 pi) / 2
    dlog L = -(tr(P dV) - y' P dV P y) / 2

A measurement that was rounded finely has omega^2 + r^2 / 12 on the diagonal. With censored and
coarsely rounded ones, log L is the above of the Gaussian measurements plus EP's log probability of
the intervals given these, theta integrated out over a flat prior in both, less log r of each
rounded one, so that it tends to the density of the exact power. At EP's fixed point the sites do
not move the value to first order, so the gradient is the one above with sites as measurements, plus
the direct effect of omega^2 on the intervals.

Position errors lengthen the distances, age multiplies the correlation, and what receivers' offsets
and errors of path loss add to V does not depend on what is estimated
(:mod:`planopt.channel.measurement_covariance`): neither changes the derivatives' form.

Generalised least squares of Gaussian measurements, and their restricted log likelihood.

Intervals beside Gaussian measurements: the sites that stand for them, the likelihood of all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import inverse, log_determinant, lower_factor, solve_lower
from planopt.channel.estimation.likelihood_data import (
    SITE_TOLERANCE,
    Covariance,
    Evaluated,
    LikelihoodData,
)
from planopt.channel.gaussian_sites import (
    TOLERANCE,
    Intervals,
    IntervalSites,
    LatentPrior,
    interval_sites,
    rounded_variance_db2,
)


@dataclass(frozen=True)
class GeneralisedLeastSquares:
    """The mean of measurements whose covariance is L L'."""

    coefficients: NDArray[np.float64]  # (p,) of the mean, and M = (G' V^-1 G)^-1, (p, p)
    covariance: NDArray[np.float64]
    lower: NDArray[np.float64]  # (n, n) L
    half_residual: NDArray[np.float64]  # (n,) L^-1 (y - G coefficients)
    log_likelihood: float  # The restricted log likelihood, constants included


def generalised_least_squares(
    covariance: NDArray[np.float64], columns: NDArray[np.float64], values: NDArray[np.float64]
) -> GeneralisedLeastSquares:
    """Fit `columns` ``(n, p)`` to `values` ``(n,)`` of a positive definite `covariance`."""
    lower = lower_factor(covariance)
    half_columns = solve_lower(lower, columns)
    half_values = solve_lower(lower, values)
    information = half_columns.T @ half_columns
    inverse_information = np.asarray(np.linalg.inv(information), dtype=np.float64)
    coefficients = inverse_information @ (half_columns.T @ half_values)
    residual = half_values - half_columns @ coefficients
    freedom = len(values) - columns.shape[1]
    log_likelihood = float(
        -0.5
        * (
            log_determinant(lower)
            + float(np.linalg.slogdet(information)[1])
            + float(residual @ residual)
            + freedom * np.log(2.0 * np.pi)
        )
    )
    return GeneralisedLeastSquares(
        coefficients, inverse_information, lower, residual, log_likelihood
    )


def sites_and_likelihood(
    data: LikelihoodData,
    latent_covariance: NDArray[np.float64],  # (n, n) V without multipath and rounding
    nugget: float,
    start: IntervalSites | None,
    tolerance: float,
) -> tuple[IntervalSites, float]:
    """Sites of the intervals given the Gaussian measurements, and log L of all."""
    exact, width = data.exact, data.width_db[data.exact :]
    rounded = np.isfinite(width)
    known = Intervals(data.power_db[exact:] + np.where(rounded, 0.5 * width, 0.0), width)
    prior, exact_log_likelihood = _interval_prior(data, latent_covariance, nugget)
    sites = interval_sites(prior, known, nugget, start, tolerance)
    return sites, exact_log_likelihood + sites.log_evidence - float(np.log(width[rounded]).sum())


def _interval_prior(
    data: LikelihoodData, latent_covariance: NDArray[np.float64], nugget: float
) -> tuple[LatentPrior, float]:
    """Return the others and theta given the Gaussian measurements, and their log L.

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


@dataclass(frozen=True)
class Evaluation:
    """The restricted likelihood at one point."""

    log_likelihood: float  # log L, constants included
    gradient: NDArray[np.float64]  # (3,) by xi^2, omega^2, beta
    # (3, 3) the average of observed and expected information, y' P dV_i P dV_j P y / 2, with sites
    # as measurements; positive semidefinite
    information: NDArray[np.float64]
    # Generalised least squares of the mean and its covariance M, from all measurements
    coefficients: NDArray[np.float64]
    coefficient_covariance: NDArray[np.float64]
    sites: IntervalSites | None  # Those of the intervals, to start the next evaluation from
    # P, (n, n); `noise_db2` (n,) is the diagonal of V beyond shadowing
    projection: NDArray[np.float64]
    noise_db2: NDArray[np.float64]


class DenseLikelihood:
    """The likelihood from one factor of all; keeps the last sites, so that EP starts warm."""

    def __init__(self, data: LikelihoodData) -> None:
        self._data = data
        self._sites: IntervalSites | None = None

    def at(self, covariance: Covariance, tolerance: float = 0.0) -> Evaluation:
        """Evaluate it; a larger `tolerance` would save nothing."""
        at = evaluate(self._data, covariance, self._sites, SITE_TOLERANCE)
        self._sites = at.sites
        return at

    def information(self, covariance: Covariance, at: Evaluated) -> NDArray[np.float64]:
        """The expected information."""
        if not isinstance(at, Evaluation):
            at = self.at(covariance)
        return expected_information(self._data, covariance, at)


def evaluate(
    data: LikelihoodData,
    covariance: Covariance,
    start: IntervalSites | None = None,
    site_tolerance: float = TOLERANCE,
) -> Evaluation:
    """The restricted likelihood, its gradient and the mean at one point."""
    shadow, nugget, beta = covariance
    correlation = data.correlation(beta)
    total = shadow * correlation
    if data.fixed_db2 is not None:
        total += data.fixed_db2
    count, exact = len(data.power_db), data.exact
    noise = nugget + rounded_variance_db2(data.width_db)
    values, extra, slope, sites = data.power_db, 0.0, 0.0, None
    if exact < count:
        sites, extra = sites_and_likelihood(data, total, nugget, start, site_tolerance)
        replaced = sites.as_measurements()
        values = np.concatenate([values[:exact], replaced.values_db])
        noise[exact:] = replaced.noise_variance_db2
        slope = sites.evidence_slope
    total[np.diag_indices(count)] += noise
    gls = generalised_least_squares(total, data.columns, values)
    whole = inverse(gls.lower)
    weights = whole @ data.columns
    projection = whole - weights @ gls.covariance @ weights.T
    residual = projection @ values
    by_beta = correlation * data.distance_m
    by_beta *= shadow / beta**2
    traces = [
        np.vdot(projection, correlation),
        np.diag(projection)[:exact].sum(),
        np.vdot(projection, by_beta),
    ]
    # Rows dV_i P y.
    moved = np.stack([correlation @ residual, np.zeros(count), by_beta @ residual])
    moved[1, :exact] = residual[:exact]
    gradient = -0.5 * (np.array(traces) - moved @ residual)
    gradient[1] += slope
    # Rounded ones tell of omega^2 too: their sites' variances nearly grow as it does.
    moved[1] = np.where(np.isfinite(data.width_db), residual, 0.0)
    return Evaluation(
        gls.log_likelihood if sites is None else extra,
        gradient,
        0.5 * moved @ projection @ moved.T,
        gls.coefficients,
        gls.covariance,
        sites,
        projection,
        noise,
    )


def profiled_log_likelihood(
    data: LikelihoodData, correlated_share: float, decorrelation_m: float
) -> tuple[float, float]:
    """Log L with the total variance profiled out, cheap, for starts; `data` without censored ones.

    Offsets of receivers have a flat prior here, and errors of path loss are left out: a covariance
    that does not scale with the total cannot be profiled.
    """
    count = data.exact
    correlation = correlated_share * data.correlation(decorrelation_m)
    correlation[np.diag_indices(count)] = 1.0
    columns = data.flat_columns()
    gls = generalised_least_squares(correlation, columns, data.power_db)
    freedom = count - columns.shape[1]
    quadratic = float(gls.half_residual @ gls.half_residual)
    variance = max(quadratic / freedom, 1e-12)
    unit = gls.log_likelihood + 0.5 * quadratic
    return unit - 0.5 * freedom * (np.log(variance) + 1.0), variance


def expected_information(
    data: LikelihoodData, covariance: Covariance, at: Evaluation
) -> NDArray[np.float64]:
    """Expected information of (xi^2, omega^2, beta), tr(P dV_i P dV_j) / 2; (3, 3).

    Intervals count as the Gaussian sites they are replaced by. A rounded one's variance is taken to
    grow as omega^2; what censored ones tell of omega^2 is left out, so that its error is not
    understated.
    """
    shadow, _, beta = covariance
    correlation = data.correlation(beta)
    by_beta = correlation * data.distance_m * (shadow / beta**2)
    by_nugget = np.zeros_like(correlation)
    measured = np.isfinite(data.width_db)
    by_nugget[:, measured] = at.projection[:, measured]
    products = [at.projection @ correlation, by_nugget, at.projection @ by_beta]
    return np.array([[0.5 * float(np.vdot(a.T, b)) for b in products] for a in products])
