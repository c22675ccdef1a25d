"""The restricted likelihood of xi^2, omega^2 and beta, with gradient, censoring included.

Without censoring, with V = xi^2 exp(-d / beta) + omega^2 I and P = V^-1 - V^-1 G M G' V^-1,
M = (G' V^-1 G)^-1 (theory 4.7):

    log L = -(log |V| + log |G' V^-1 G| + y' P y + (n - p) log 2 pi) / 2
    dlog L = -(tr(P dV) - y' P dV P y) / 2

With censored measurements, log L is that of the exact ones plus EP's log probability of the limits
given the exact ones, theta integrated out over a flat prior in both. At EP's fixed point the sites
do not move the value to first order, so the gradient is the one above with sites as measurements,
plus the direct effect of omega^2 on the limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.censoring import CensoredSites, censored_sites
from planopt.channel.cholesky import inverse, log_determinant, lower_factor, solve_lower
from planopt.channel.kernel import pairwise_distance_m
from planopt.channel.mean_model import MeanModel
from planopt.channel.measurements import Measurements

Covariance = tuple[float, float, float]
"""xi^2 (dB^2), omega^2 (dB^2), beta (m)."""


@dataclass(frozen=True)
class LikelihoodData:
    """Measurements, exact ones first, as the likelihood needs them.

    Attributes
    ----------
    distance_m
        ``(n, n)``.
    columns
        ``(n, p)`` of the mean model.
    power_db
        ``(n,)`` power less the mean model's offset; the limit for censored ones.
    exact
        Number of uncensored measurements, at least p + 1; they come first.
    """

    distance_m: NDArray[np.float64]
    columns: NDArray[np.float64]
    power_db: NDArray[np.float64]
    exact: int


@dataclass(frozen=True)
class Evaluation:
    """The restricted likelihood at one point.

    Attributes
    ----------
    log_likelihood
        log L, constants included.
    gradient
        ``(3,)`` by xi^2, omega^2, beta.
    coefficients, coefficient_covariance
        Generalised least squares of the mean and its covariance M, from all measurements.
    sites
        The censored ones, to start the next evaluation from.
    projection
        P, ``(n, n)``; `noise_db2` ``(n,)`` is the diagonal of V beyond shadowing.
    """

    log_likelihood: float
    gradient: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    coefficient_covariance: NDArray[np.float64]
    sites: CensoredSites | None
    projection: NDArray[np.float64]
    noise_db2: NDArray[np.float64]


@dataclass(frozen=True)
class _Gls:
    """Generalised least squares of Gaussian measurements whose covariance is L L'."""

    lower: NDArray[np.float64]
    half_columns: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    covariance: NDArray[np.float64]
    half_residual: NDArray[np.float64]
    log_likelihood: float


def likelihood_data(model: MeanModel, measurements: Measurements) -> LikelihoodData:
    """Sort exact measurements first and compute distances."""
    order = np.argsort(measurements.censored, kind="stable")
    positions = measurements.positions_m[order]
    return LikelihoodData(
        pairwise_distance_m(positions, positions),
        model.columns[order],
        (measurements.power_dbm - model.offset_db)[order],
        int((~measurements.censored).sum()),
    )


def profiled_log_likelihood(
    data: LikelihoodData, correlated_share: float, decorrelation_m: float
) -> tuple[float, float]:
    """Log L with the total variance profiled out, cheap, for starts; `data` without censored ones.

    Returns
    -------
    tuple[float, float]
        log L up to a constant, and the variance xi^2 + omega^2 at which it is reached.
    """
    count = data.exact
    correlation = correlated_share * np.exp(-data.distance_m / decorrelation_m)
    correlation[np.diag_indices(count)] = 1.0
    gls = _gls(correlation, data.columns, data.power_db)
    freedom = count - data.columns.shape[1]
    quadratic = float(gls.half_residual @ gls.half_residual)
    variance = max(quadratic / freedom, 1e-12)
    unit = gls.log_likelihood + 0.5 * quadratic
    return unit - 0.5 * freedom * (np.log(variance) + 1.0), variance


def evaluate(
    data: LikelihoodData, covariance: Covariance, start: CensoredSites | None = None
) -> Evaluation:
    """The restricted likelihood, its gradient and the mean at one point.

    Parameters
    ----------
    data
        From :func:`likelihood_data`.
    covariance
        xi^2, omega^2 and beta, all positive.
    start
        Sites of a point near by.
    """
    shadow, nugget, beta = covariance
    correlation = np.exp(-data.distance_m / beta)
    count, exact = len(data.power_db), data.exact
    noise = np.full(count, nugget)
    values, extra, slope, sites = data.power_db, 0.0, 0.0, None
    if exact < count:
        sites, mean, exact_log_likelihood = _censored(data, shadow * correlation, nugget, start)
        replaced = sites.as_measurements(mean)
        values = np.concatenate([values[:exact], replaced.values_db])
        noise[exact:] = replaced.noise_variance_db2
        extra, slope = exact_log_likelihood + sites.log_evidence, sites.evidence_slope
    total = shadow * correlation
    total[np.diag_indices(count)] += noise
    gls = _gls(total, data.columns, values)
    whole = inverse(gls.lower)
    weights = whole @ data.columns
    projection = whole - weights @ gls.covariance @ weights.T
    residual = projection @ values
    by_beta = correlation * data.distance_m
    by_beta *= shadow / beta**2
    gradient = -0.5 * np.array(
        [
            np.vdot(projection, correlation) - residual @ correlation @ residual,
            np.diag(projection)[:exact].sum() - residual[:exact] @ residual[:exact],
            np.vdot(projection, by_beta) - residual @ by_beta @ residual,
        ]
    )
    gradient[1] += slope
    return Evaluation(
        gls.log_likelihood if sites is None else extra,
        gradient,
        gls.coefficients,
        gls.covariance,
        sites,
        projection,
        noise,
    )


def expected_information(
    data: LikelihoodData, covariance: Covariance, at: Evaluation
) -> NDArray[np.float64]:
    """Expected information of (xi^2, omega^2, beta), tr(P dV_i P dV_j) / 2; (3, 3).

    Censored measurements count as the Gaussian sites they are replaced by; what they tell of
    omega^2 is left out, so that its error is not understated.
    """
    shadow, _, beta = covariance
    correlation = np.exp(-data.distance_m / beta)
    by_beta = correlation * data.distance_m * (shadow / beta**2)
    by_nugget = np.zeros_like(correlation)
    by_nugget[:, : data.exact] = at.projection[:, : data.exact]
    products = [at.projection @ correlation, by_nugget, at.projection @ by_beta]
    return np.array([[0.5 * float(np.vdot(a.T, b)) for b in products] for a in products])


def _censored(
    data: LikelihoodData,
    shadow_covariance: NDArray[np.float64],
    nugget: float,
    start: CensoredSites | None,
) -> tuple[CensoredSites, NDArray[np.float64], float]:
    """Sites of the limits given the exact measurements, their prior mean, and log L of the latter.

    The prior is the universal kriging one: theta has a flat prior.
    """
    exact = data.exact
    total = shadow_covariance[:exact, :exact].copy()
    total[np.diag_indices(exact)] += nugget
    gls = _gls(total, data.columns[:exact], data.power_db[:exact])
    half_cross = solve_lower(gls.lower, shadow_covariance[:exact, exact:])
    rest = data.columns[exact:] - half_cross.T @ gls.half_columns
    mean = data.columns[exact:] @ gls.coefficients + half_cross.T @ gls.half_residual
    covariance = (
        shadow_covariance[exact:, exact:]
        - half_cross.T @ half_cross
        + rest @ gls.covariance @ rest.T
    )
    sites = censored_sites(mean, covariance, data.power_db[exact:], nugget, start)
    return sites, mean, gls.log_likelihood


def _gls(
    covariance: NDArray[np.float64], columns: NDArray[np.float64], values: NDArray[np.float64]
) -> _Gls:
    """Generalised least squares and the restricted log likelihood."""
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
    return _Gls(lower, half_columns, coefficients, inverse_information, residual, log_likelihood)
