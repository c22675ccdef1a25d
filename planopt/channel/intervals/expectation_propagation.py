"""Measurements known to lie in an interval as Gaussian ones, by expectation propagation (EP).

A receiver's floor gives the likelihood Phi((floor - f) / omega) of the noise-free power f, a
receiver's scale of step r the likelihood Phi((y + r/2 - f) / omega) - Phi((y - r/2 - f) / omega).
Both are log-concave, so EP replaces each such factor by a Gaussian *site* of positive variance;
everything downstream then works as with ordinary measurements whose noise differs from point to
point. Equations: Rasmussen and Williams, Gaussian Processes for Machine Learning, section 3.6, with
the moments of the truncated normal in place of the probit's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import log_determinant, lower_factor, solve_lower
from planopt.channel.intervals.sites import (
    MAX_SITE_VARIANCE_DB2,
    Intervals,
    IntervalSites,
    LatentPrior,
    first_sites,
    matched_sites,
)
from planopt.channel.intervals.truncated_normal import truncated_normal

TOLERANCE = 1e-7
"""Of sites, unless another is asked for."""

MAX_SWEEPS = 300


def interval_sites(
    prior: LatentPrior,
    intervals: Intervals,
    noise_variance_db2: float,
    start: IntervalSites | None = None,
    tolerance: float = TOLERANCE,
) -> IntervalSites:
    """Expectation propagation for intervals of a Gaussian vector, all sites at once, damped."""
    limit = intervals.upper_db - prior.mean_db
    precision, shift = _first(prior, intervals, noise_variance_db2, start)
    least = np.where(np.isinf(intervals.width_db), 0.0, 1.0 / MAX_SITE_VARIANCE_DB2)
    step, last = 1.0, np.inf
    state = best = _State.of(prior, precision, shift, limit, intervals.width_db, noise_variance_db2)
    for _ in range(MAX_SWEEPS):
        if state.error < best.error:
            best = state
        if state.error < tolerance:
            break
        # Sites that swing between sweeps are damped harder, for good.
        step = step if state.error < last else max(0.7 * step, 0.05)
        last = state.error
        precision = precision + step * (state.tilted.precision - precision)
        # All intervals may say nothing at first, beside a flat prior of theta that needs them.
        precision = np.maximum(precision, least)
        shift = shift + step * (state.tilted.shift - shift)
        state = _State.of(prior, precision, shift, limit, intervals.width_db, noise_variance_db2)
    return IntervalSites(
        prior.mean_db, best.precision, best.shift, _log_evidence(best), best.tilted.slope
    )


def _first(
    prior: LatentPrior,
    intervals: Intervals,
    noise: float,
    start: IntervalSites | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sites to begin with: those of `start`, else the middles of the intervals, and no limits."""
    if start is not None:
        return start.precision, start.shift + start.precision * (start.mean_db - prior.mean_db)
    return first_sites(intervals.upper_db - prior.mean_db, intervals.width_db, noise)


@dataclass(frozen=True)
class _Posterior:
    """Means and variances of f - mean under prior and sites, and the log of their integral."""

    variance: NDArray[np.float64]
    mean: NDArray[np.float64]
    log_integral: float

    @staticmethod
    def of(
        prior: LatentPrior, precision: NDArray[np.float64], shift: NDArray[np.float64]
    ) -> _Posterior:
        """Condition on the sites through B = I + S^1/2 covariance S^1/2, then on delta."""
        root = np.sqrt(precision)
        scaled = root[:, None] * prior.covariance_db2
        inner = scaled * root
        inner.flat[:: len(inner) + 1] += 1.0
        lower = lower_factor(inner)
        half = solve_lower(lower, scaled)
        variance = np.diag(prior.covariance_db2) - np.einsum("ij,ij->j", half, half)
        mean = prior.covariance_db2 @ shift - half.T @ (half @ shift)
        log_integral = 0.5 * float(shift @ mean) - 0.5 * log_determinant(lower)
        if prior.columns.shape[1]:
            half_columns = solve_lower(lower, root[:, None] * prior.columns)
            information = lower_factor(prior.information + half_columns.T @ half_columns)
            # The columns, as far as the sites leave f free to follow them.
            moved = solve_lower(information, (prior.columns - half.T @ half_columns).T)
            score = moved @ shift + solve_lower(information, prior.score)
            variance = variance + np.einsum("ij,ij->j", moved, moved)
            mean = mean + moved.T @ score
            log_integral += 0.5 * float(score @ score) - 0.5 * log_determinant(information)
            log_integral += 0.5 * len(score) * math.log(2.0 * math.pi)
        return _Posterior(np.maximum(variance, 1e-12), mean, log_integral)


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
        interval: NDArray[np.float64],
        noise: float,
    ) -> _Tilted:
        """Leave each site out in turn and match the moments of cavity times likelihood."""
        rest = np.maximum(1.0 - precision * posterior.variance, 1e-12)
        variance = posterior.variance / rest
        mean = (posterior.mean - posterior.variance * shift) / rest
        width2 = noise + variance
        width = np.sqrt(width2)
        given = truncated_normal((limit - mean) / width, interval / width)
        matched = matched_sites(mean, variance, given, noise)
        shrink = np.maximum(1.0 - given.variance, 0.0)
        return _Tilted(
            mean,
            variance,
            given.log_probability,
            *matched,
            0.5 * float(((given.mean**2 - shrink) / width2).sum()),
        )


@dataclass(frozen=True)
class _State:
    """Sites with what follows from them, and how far they are from reproducing themselves."""

    precision: NDArray[np.float64]
    shift: NDArray[np.float64]
    posterior: _Posterior
    tilted: _Tilted
    error: float

    @staticmethod
    def of(
        prior: LatentPrior,
        precision: NDArray[np.float64],
        shift: NDArray[np.float64],
        limit: NDArray[np.float64],
        interval: NDArray[np.float64],
        noise: float,
    ) -> _State:
        """Evaluate sites."""
        posterior = _Posterior.of(prior, precision, shift)
        tilted = _Tilted.of(posterior, precision, shift, limit, interval, noise)
        error = max(
            np.abs((tilted.precision - precision) * posterior.variance).max(),
            np.abs((tilted.shift - shift) * np.sqrt(posterior.variance)).max(),
        )
        return _State(precision, shift, posterior, tilted, float(error))


def _log_evidence(state: _State) -> float:
    """EP's log marginal likelihood, in a form that stays finite at precision 0."""
    tilted, precision, shift = state.tilted, state.precision, state.shift
    gain = 1.0 + precision * tilted.cavity_variance
    cavity = (
        precision * tilted.cavity_mean**2
        - 2.0 * shift * tilted.cavity_mean
        - shift**2 * tilted.cavity_variance
    ) / (2.0 * gain)
    each = tilted.log_normaliser + 0.5 * np.log(gain) + cavity
    return state.posterior.log_integral + float(each.sum())
