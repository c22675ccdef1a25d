"""The restricted likelihood of xi^2, omega^2 and beta, with gradient, of intervals too.

Of exact measurements, with V = xi^2 exp(-d / beta) + omega^2 I and P = V^-1 - V^-1 G M G' V^-1,
M = (G' V^-1 G)^-1 (theory 4.7):

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
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import inverse, log_determinant, lower_factor, solve_lower
from planopt.channel.intervals.censoring import intervals
from planopt.channel.intervals.expectation_propagation import TOLERANCE, interval_sites
from planopt.channel.intervals.sites import (
    Intervals,
    IntervalSites,
    LatentPrior,
    rounded_variance_db2,
)
from planopt.channel.kernel import pairwise_distance_m
from planopt.channel.mean_model import MeanModel
from planopt.channel.measurement_covariance import (
    ageing,
    blurred_m2,
    measured_origins,
    measured_path_loss_variance_db2,
    offset_covariance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters

LEAST_FREEDOM = 3
"""Starts and weights leave offsets out where fewer measurements would be left over."""

RANK_TOLERANCE = 1e-9
"""Columns below this share of the largest singular value add nothing."""

Covariance = tuple[float, float, float]
"""xi^2 (dB^2), omega^2 (dB^2), beta (m)."""


@dataclass(frozen=True)
class LikelihoodData:
    """Measurements, Gaussian ones first, as the likelihood needs them.

    Attributes
    ----------
    distance_m
        ``(n, n)``, position errors included.
    columns
        ``(n, p)`` of the mean model.
    power_db
        ``(n,)`` power less the mean model's offset; the limit for censored ones.
    exact
        Number of measurements that are Gaussian, exact or rounded finely; they come first. The
        others are intervals.
    width_db
        ``(n,)`` step r that the power was rounded to, 0 for none; ``inf`` for censored ones.
    age
        ``(n, n)`` the factor of the correlation; None where the channel does not forget.
    fixed_db2
        ``(n, n)`` covariance that is not estimated; None where there is none.
    receiver
        ``(n,)`` number of the receiver.
    """

    distance_m: NDArray[np.float64]
    columns: NDArray[np.float64]
    power_db: NDArray[np.float64]
    exact: int
    width_db: NDArray[np.float64]
    age: NDArray[np.float64] | None
    fixed_db2: NDArray[np.float64] | None
    receiver: NDArray[np.intp]

    def gaussian(self, rows: NDArray[np.intp]) -> LikelihoodData:
        """Those of `rows`, which are Gaussian ones."""
        square = np.ix_(rows, rows)
        return LikelihoodData(
            self.distance_m[square],
            self.columns[rows],
            self.power_db[rows],
            len(rows),
            self.width_db[rows],
            None if self.age is None else self.age[square],
            None if self.fixed_db2 is None else self.fixed_db2[square],
            self.receiver[rows],
        )

    def flat_columns(self) -> NDArray[np.float64]:
        """The mean's columns, and a basis of what receivers' offsets add to them; ``(n, q)``.

        For offsets under a flat prior. Where too few measurements would be left, or there are no
        offsets, the mean's alone.
        """
        if not self.receiver.any():
            return self.columns
        numbers = np.unique(self.receiver)
        whole = np.column_stack([self.columns, self.receiver[:, None] == numbers[numbers != 0]])
        basis, spread, _ = np.linalg.svd(whole, full_matrices=False)
        basis = basis[:, spread > RANK_TOLERANCE * spread[0]]
        return basis if len(basis) - basis.shape[1] >= LEAST_FREEDOM else self.columns


@dataclass(frozen=True)
class Evaluation:
    """The restricted likelihood at one point.

    Attributes
    ----------
    log_likelihood
        log L, constants included.
    gradient
        ``(3,)`` by xi^2, omega^2, beta.
    information
        ``(3, 3)`` the average of observed and expected information, y' P dV_i P dV_j P y / 2, with
        sites as measurements; positive semidefinite.
    coefficients, coefficient_covariance
        Generalised least squares of the mean and its covariance M, from all measurements.
    sites
        Those of the intervals, to start the next evaluation from.
    projection
        P, ``(n, n)``; `noise_db2` ``(n,)`` is the diagonal of V beyond shadowing.
    """

    log_likelihood: float
    gradient: NDArray[np.float64]
    information: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    coefficient_covariance: NDArray[np.float64]
    sites: IntervalSites | None
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


def likelihood_data(
    model: MeanModel,
    measurements: Measurements,
    known: ChannelParameters,
    as_interval: NDArray[np.bool_] | None = None,
) -> LikelihoodData:
    """Sort Gaussian measurements first and compute distances.

    Parameters
    ----------
    model
        Mean model at the same positions.
    measurements
        n measurements, at least p + 2 of them not censored.
    known
        Where the forgetting time is taken from; and the station and a rough n_PL, for what an error
        of position does to path loss.
    as_interval
        ``(n,)`` which are intervals to the likelihood, the censored ones among them
        (:func:`planopt.channel.intervals.censoring.needs_site`); None for the censored ones alone.
    """
    chosen = measurements.censored if as_interval is None else as_interval
    order = np.argsort(chosen, kind="stable")
    ordered = measurements.take(order)
    origins = measured_origins(ordered, known)
    positions, times = origins.positions_m, origins.time_s
    distance = pairwise_distance_m(positions, positions, blurred_m2(origins, origins))
    np.fill_diagonal(distance, 0.0)
    bands = intervals(measurements)
    power = np.where(measurements.censored, bands.upper_db, measurements.power_dbm)
    return LikelihoodData(
        distance,
        model.columns[order],
        (power - model.offset_db)[order],
        int((~chosen).sum()),
        bands.width_db[order],
        None if times is None else ageing(times[:, None], times, known),
        _fixed_covariance_db2(ordered, known),
        ordered.receiver,
    )


def _fixed_covariance_db2(
    measurements: Measurements, known: ChannelParameters
) -> NDArray[np.float64] | None:
    """Of receivers' offsets and errors of path loss; (n, n)."""
    if not (measurements.receiver.any() or measurements.position_std_m.any()):
        return None
    fixed = np.diag(measured_path_loss_variance_db2(measurements, known))
    return fixed + offset_covariance_db2(measurements.receiver, measurements.receiver)


def profiled_log_likelihood(
    data: LikelihoodData, correlated_share: float, decorrelation_m: float
) -> tuple[float, float]:
    """Log L with the total variance profiled out, cheap, for starts; `data` without censored ones.

    Offsets of receivers have a flat prior here, and errors of path loss are left out: a covariance
    that does not scale with the total cannot be profiled.

    Returns
    -------
    tuple[float, float]
        log L up to a constant, and the variance xi^2 + omega^2 at which it is reached.
    """
    count = data.exact
    correlation = correlated_share * _correlation(data, decorrelation_m)
    correlation[np.diag_indices(count)] = 1.0
    columns = data.flat_columns()
    gls = _gls(correlation, columns, data.power_db)
    freedom = count - columns.shape[1]
    quadratic = float(gls.half_residual @ gls.half_residual)
    variance = max(quadratic / freedom, 1e-12)
    unit = gls.log_likelihood + 0.5 * quadratic
    return unit - 0.5 * freedom * (np.log(variance) + 1.0), variance


def evaluate(
    data: LikelihoodData,
    covariance: Covariance,
    start: IntervalSites | None = None,
    site_tolerance: float = TOLERANCE,
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
    site_tolerance
        Of :func:`planopt.channel.intervals.expectation_propagation.interval_sites`. What is left of
        it is of second order in log L, and of first order in the gradient.
    """
    shadow, nugget, beta = covariance
    correlation = _correlation(data, beta)
    total = shadow * correlation
    if data.fixed_db2 is not None:
        total += data.fixed_db2
    count, exact = len(data.power_db), data.exact
    noise = nugget + rounded_variance_db2(data.width_db)
    values, extra, slope, sites = data.power_db, 0.0, 0.0, None
    if exact < count:
        sites, extra = _interval_sites(data, total, nugget, start, site_tolerance)
        replaced = sites.as_measurements()
        values = np.concatenate([values[:exact], replaced.values_db])
        noise[exact:] = replaced.noise_variance_db2
        slope = sites.evidence_slope
    total[np.diag_indices(count)] += noise
    gls = _gls(total, data.columns, values)
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


def expected_information(
    data: LikelihoodData, covariance: Covariance, at: Evaluation
) -> NDArray[np.float64]:
    """Expected information of (xi^2, omega^2, beta), tr(P dV_i P dV_j) / 2; (3, 3).

    Intervals count as the Gaussian sites they are replaced by. A rounded one's variance is taken to
    grow as omega^2; what censored ones tell of omega^2 is left out, so that its error is not
    understated.
    """
    shadow, _, beta = covariance
    correlation = _correlation(data, beta)
    by_beta = correlation * data.distance_m * (shadow / beta**2)
    by_nugget = np.zeros_like(correlation)
    measured = np.isfinite(data.width_db)
    by_nugget[:, measured] = at.projection[:, measured]
    products = [at.projection @ correlation, by_nugget, at.projection @ by_beta]
    return np.array([[0.5 * float(np.vdot(a.T, b)) for b in products] for a in products])


def _correlation(data: LikelihoodData, beta: float) -> NDArray[np.float64]:
    """exp(-d / beta) by the factor of age; (n, n)."""
    correlation = np.exp(-data.distance_m / beta)
    if data.age is not None:
        correlation *= data.age
    return correlation


def _interval_sites(
    data: LikelihoodData,
    latent_covariance: NDArray[np.float64],
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
