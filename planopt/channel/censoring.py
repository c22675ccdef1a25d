"""Censored measurements ("at most this power") as Gaussian ones, by expectation propagation.

A receiver's floor gives the likelihood Phi((floor - f) / omega) of the noise-free power f. It is
log-concave, so expectation propagation (EP) replaces each such factor by a Gaussian *site* of
positive variance; everything downstream then works as with ordinary measurements whose noise
differs from point to point. Equations: Rasmussen and Williams, Gaussian Processes for Machine
Learning, section 3.6, for a probit likelihood of width omega.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.cholesky import log_determinant, lower_factor, solve_lower
from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.measurements import Measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters
from planopt.channel.path_loss import regressors

MAX_SITE_VARIANCE_DB2 = 1e5
"""A censored value that says nothing has an infinite site variance; this stands for it."""

MIN_NOISE_VARIANCE_DB2 = 1e-4
"""omega^2 is not taken below this, so that factors exist where positions repeat."""

TOLERANCE = 1e-7
"""Sites have converged when no site moves by more than this in units of its posterior."""

MAX_SWEEPS = 300


@dataclass(frozen=True)
class Sites:
    """Measurements as Gaussian ones: value = path loss + shadowing + independent noise.

    Attributes
    ----------
    values_db
        ``(n,)`` values in dBm.
    noise_variance_db2
        ``(n,)`` variance of the noise of each, positive, at most `MAX_SITE_VARIANCE_DB2` for
        censored measurements.
    """

    values_db: NDArray[np.float64]
    noise_variance_db2: NDArray[np.float64]


@dataclass(frozen=True)
class CensoredSites:
    """The EP approximation of ``N(f; mean, covariance) prod Phi((upper - f) / omega)``.

    Attributes
    ----------
    precision, shift
        ``(m,)`` natural parameters of the sites, relative to the prior mean: a site is
        proportional to ``exp(-precision (f - mean)^2 / 2 + shift (f - mean))``.
    log_evidence
        EP's log of the integral of that product.
    evidence_slope
        Derivative of `log_evidence` by omega^2 through the likelihood alone.
    """

    precision: NDArray[np.float64]
    shift: NDArray[np.float64]
    log_evidence: float
    evidence_slope: float

    def as_measurements(self, mean_db: NDArray[np.float64]) -> Sites:
        """The sites as Gaussian measurements of f, whose prior mean was `mean_db` (m,)."""
        precision = np.maximum(self.precision, 1.0 / MAX_SITE_VARIANCE_DB2)
        return Sites(mean_db + self.shift / precision, 1.0 / precision)


@one_blas_thread()
def gaussian_sites(parameters: ChannelParameters, measurements: Measurements) -> Sites:
    """Replace censored measurements by Gaussian ones, given the channel's parameters.

    The sites are conditioned jointly on all measurements: a censored one among strong neighbours
    pulls harder than one where a weak signal was expected anyway.

    Parameters
    ----------
    parameters
        The channel; its theta is taken as exact.
    measurements
        n measurements, some of which may be censored.

    Returns
    -------
    Sites
        ``(n,)`` each, in the order of `measurements`. Uncensored ones are returned as they are,
        with variance omega^2.
    """
    omega2 = parameters.multipath_std_db**2
    values = measurements.power_dbm.astype(np.float64)
    variances = np.full(len(values), omega2)
    is_censored = measurements.censored
    if not is_censored.any():
        return Sites(values, variances)
    omega2 = max(omega2, MIN_NOISE_VARIANCE_DB2)
    theta = np.array([parameters.k_pl_db, parameters.n_pl])
    path_loss = regressors(measurements.positions_m, parameters.station) @ theta
    at_censored = measurements.positions_m[is_censored]
    mean = path_loss[is_censored]
    covariance = shadow_covariance_db2(at_censored, at_censored, parameters)
    if not is_censored.all():
        at_exact = measurements.positions_m[~is_censored]
        exact_covariance = shadow_covariance_db2(at_exact, at_exact, parameters)
        exact_covariance[np.diag_indices_from(exact_covariance)] += omega2
        cross = shadow_covariance_db2(at_exact, at_censored, parameters)
        lower = lower_factor(exact_covariance)
        half = solve_lower(lower, cross)
        mean = mean + half.T @ solve_lower(lower, (values - path_loss)[~is_censored])
        covariance = covariance - half.T @ half
    found = censored_sites(mean, covariance, values[is_censored], omega2).as_measurements(mean)
    values[is_censored] = found.values_db
    variances[is_censored] = found.noise_variance_db2
    return Sites(values, variances)


def censored_sites(
    mean_db: NDArray[np.float64],
    covariance_db2: NDArray[np.float64],
    upper_db: NDArray[np.float64],
    noise_variance_db2: float,
    start: CensoredSites | None = None,
) -> CensoredSites:
    """Expectation propagation for upper limits on a Gaussian vector, all sites at once, damped.

    Parameters
    ----------
    mean_db, covariance_db2
        ``(m,)`` and ``(m, m)``: what is known of the noise-free power f without the limits.
    upper_db
        ``(m,)`` the limits: f + noise is at most this.
    noise_variance_db2
        omega^2 > 0.
    start
        Sites to start from, of a similar problem of the same size.

    Returns
    -------
    CensoredSites
        The fixed point, or the nearest to it after `MAX_SWEEPS` sweeps. The log-concave
        likelihood keeps every precision non-negative.
    """
    limit = upper_db - mean_db
    count = len(limit)
    precision, shift = (
        (np.zeros(count), np.zeros(count)) if start is None else (start.precision, start.shift)
    )
    step, last, best = 1.0, np.inf, (np.inf, precision, shift)
    for _ in range(MAX_SWEEPS):
        posterior = _Posterior.of(covariance_db2, precision, shift)
        tilted = _Tilted.of(posterior, precision, shift, limit, noise_variance_db2)
        error = float(
            max(
                np.abs((tilted.precision - precision) * posterior.variance).max(),
                np.abs((tilted.shift - shift) * np.sqrt(posterior.variance)).max(),
            )
        )
        if error < best[0]:
            best = (error, precision, shift)
        if error < TOLERANCE:
            break
        # Sites that swing between sweeps are damped harder, for good.
        step = step if error < last else max(0.7 * step, 0.05)
        last = error
        precision = precision + step * (tilted.precision - precision)
        shift = shift + step * (tilted.shift - shift)
    _, precision, shift = best
    posterior = _Posterior.of(covariance_db2, precision, shift)
    tilted = _Tilted.of(posterior, precision, shift, limit, noise_variance_db2)
    return CensoredSites(
        precision, shift, _log_evidence(posterior, tilted, precision, shift), tilted.slope
    )


@dataclass(frozen=True)
class _Posterior:
    """Mean and variances of f - mean under prior and sites."""

    covariance: NDArray[np.float64]
    variance: NDArray[np.float64]
    mean: NDArray[np.float64]
    log_determinant: float

    @staticmethod
    def of(
        prior: NDArray[np.float64], precision: NDArray[np.float64], shift: NDArray[np.float64]
    ) -> _Posterior:
        """Condition N(0, prior) on the sites through B = I + S^1/2 prior S^1/2."""
        root = np.sqrt(precision)
        inner = root[:, None] * prior * root[None, :]
        inner[np.diag_indices_from(inner)] += 1.0
        lower = lower_factor(inner)
        half = solve_lower(lower, root[:, None] * prior)
        covariance = prior - half.T @ half
        variance = np.maximum(np.diag(covariance), 1e-12)
        return _Posterior(covariance, variance, covariance @ shift, log_determinant(lower))


@dataclass(frozen=True)
class _Tilted:
    """The cavities, the sites that match the tilted moments, and log normalisers."""

    cavity_mean: NDArray[np.float64]
    cavity_variance: NDArray[np.float64]
    log_normaliser: NDArray[np.float64]
    precision: NDArray[np.float64]
    shift: NDArray[np.float64]
    slope: float

    @staticmethod
    def of(
        posterior: _Posterior,
        precision: NDArray[np.float64],
        shift: NDArray[np.float64],
        limit: NDArray[np.float64],
        noise_variance: float,
    ) -> _Tilted:
        """Leave each site out in turn and match the moments of cavity times likelihood."""
        rest = np.maximum(1.0 - precision * posterior.variance, 1e-12)
        variance = posterior.variance / rest
        mean = (posterior.mean - posterior.variance * shift) / rest
        width2 = noise_variance + variance
        width = np.sqrt(width2)
        z = (limit - mean) / width
        log_normaliser = np.asarray(log_ndtr(z), dtype=np.float64)
        hazard = np.exp(-0.5 * z * z - 0.5 * np.log(2.0 * np.pi) - log_normaliser)
        gradient = -hazard / width
        curvature = np.clip(hazard * (z + hazard), 0.0, 1.0) / width2
        left = 1.0 - curvature * variance
        return _Tilted(
            mean,
            variance,
            log_normaliser,
            curvature / left,
            (curvature * mean + gradient) / left,
            float((-0.5 * hazard * z / width2).sum()),
        )


def _log_evidence(
    posterior: _Posterior,
    tilted: _Tilted,
    precision: NDArray[np.float64],
    shift: NDArray[np.float64],
) -> float:
    """EP's log marginal likelihood, in a form that stays finite at precision 0."""
    gain = 1.0 + precision * tilted.cavity_variance
    cavity = (
        precision * tilted.cavity_mean**2
        - 2.0 * shift * tilted.cavity_mean
        - shift**2 * tilted.cavity_variance
    ) / (2.0 * gain)
    return float(
        tilted.log_normaliser.sum()
        - 0.5 * posterior.log_determinant
        + 0.5 * np.log(gain).sum()
        + 0.5 * shift @ posterior.covariance @ shift
        + cavity.sum()
    )
