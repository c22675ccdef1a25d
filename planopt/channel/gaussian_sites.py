"""Censored ("at most this power") and coarsely rounded measurements as Gaussian ones.

A power rounded to steps of r is known to r / 2 either side. While r is at most `FINE_STEP` omega
its likelihood cannot be told from a Gaussian's of variance omega^2 + r^2 / 12 (Sheppard's
correction). Beyond, and for limits, expectation propagation (EP) is used.

A receiver's floor gives the likelihood Phi((floor - f) / omega) of the noise-free power f, a
receiver's scale of step r the likelihood Phi((y + r/2 - f) / omega) - Phi((y - r/2 - f) / omega).
Both are log-concave, so EP replaces each such factor by a Gaussian *site* of positive variance;
everything downstream then works as with ordinary measurements whose noise differs from point to
point. Equations: Rasmussen and Williams, Gaussian Processes for Machine Learning, section 3.6, with
the moments of the truncated normal in place of the probit's.

Differences of distribution functions lose every digit for narrow intervals and far tails. Moments
of the truncated normal are therefore integrals of its density, scaled to 1 at its highest point, by
Gauss-Legendre quadrature over the part of the interval where it is not negligible: the relative
error of the variance stays below 1e-12 from intervals of 1e-9 standard deviations to half lines.
Half lines short of the far tail have a closed form, which is faster.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx, log_ndtr  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.cholesky import log_determinant, lower_factor, one_blas_thread, solve_lower
from planopt.channel.measurement_covariance import (
    covariance_db2,
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, regressors

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)
NODES, WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
"""Of the quadrature over [0, 1]; 40 integrate the whole normal density to 5e-14."""

NEGLIGIBLE = 76.0
"""Where x^2 exceeds its least value by this, the density has fallen by exp(-38) = 3e-17."""


LEAST_CLOSED_FORM = -20.0
"""The closed form's variance of a half line loses digits as the fourth power of its end: at this
end its relative error is 1e-10."""


@dataclass(frozen=True)
class TruncatedNormal:
    """Standard normal variables x, each given that it lies in its interval."""

    log_probability: NDArray[np.float64]  # (m,) of the interval
    mean: NDArray[np.float64]  # (m,) given the interval
    variance: NDArray[np.float64]


def truncated_normal(upper: NDArray[np.float64], width: NDArray[np.float64]) -> TruncatedNormal:
    """Condition standard normal variables on ``upper - width <= x <= upper``."""
    # Shapes: upper (m,); width (m,).
    if np.isinf(width).all() and (upper > LEAST_CLOSED_FORM).all():
        return _half_line(upper)
    # Mirrored where the middle is below 0, so that the density is highest at 0 or the lower end.
    mirrored = upper < 0.5 * width
    lower = np.where(mirrored, -upper, upper - width)
    highest = np.maximum(lower, 0.0)
    # Beyond these the density is negligible. The far end as a step from the highest point, whose
    # difference from `highest` would vanish in rounding.
    begin = np.maximum(lower, -np.sqrt(NEGLIGIBLE))
    reach = NEGLIGIBLE / (highest + np.sqrt(highest**2 + NEGLIGIBLE))
    length = np.minimum(width - (begin - lower), highest - begin + reach)
    step = length[:, None] * NODES
    # x^2 - highest^2, exact for small steps in a far tail.
    excess = (step + (begin - highest)[:, None]) * (step + (begin + highest)[:, None])
    density = WEIGHTS * np.exp(-0.5 * excess)
    mass = density.sum(axis=1)
    density /= mass[:, None]
    beyond = np.einsum("ij,ij->i", density, step)
    step -= beyond[:, None]
    mean: NDArray[np.float64] = begin + beyond
    return TruncatedNormal(
        np.log(mass * length) - 0.5 * highest**2 - 0.5 * np.log(2.0 * np.pi),
        np.where(mirrored, -mean, mean),
        np.einsum("ij,ij,ij->i", density, step, step),
    )


def _half_line(upper: NDArray[np.float64]) -> TruncatedNormal:
    """Condition on ``x <= upper``: mean -h, variance 1 - h (upper + h), h the hazard."""
    hazard = np.sqrt(2.0 / np.pi) / np.asarray(erfcx(-np.sqrt(0.5) * upper), dtype=np.float64)
    return TruncatedNormal(
        np.asarray(log_ndtr(upper), dtype=np.float64), -hazard, 1.0 - hazard * (upper + hazard)
    )


MAX_SITE_VARIANCE_DB2 = 1e5
"""A limit that says nothing has an infinite site variance; this stands for it."""


@dataclass(frozen=True)
class Sites:
    """Measurements as Gaussian ones: value = path loss + shadowing + independent noise."""

    values_db: NDArray[np.float64]  # (n,) values in dBm
    # (n,) variance of the noise of each, positive, at most `MAX_SITE_VARIANCE_DB2` for censored
    # measurements
    noise_variance_db2: NDArray[np.float64]


@dataclass(frozen=True)
class Intervals:
    """The intervals that noisy powers are known to lie in."""

    upper_db: NDArray[np.float64]  # (m,) the power is at most this,
    width_db: NDArray[np.float64]  # (m,) and at most this much below it; inf for a mere limit


@dataclass(frozen=True)
class LatentPrior:
    """The distribution of the noise-free power f without the intervals.

    f = mean + columns @ delta + u with u ~ N(0, covariance) and delta of density proportional to
    exp(score' delta - delta' information delta / 2): path loss, given other measurements.
    """

    mean_db: NDArray[np.float64]  # (m,) and (m, m)
    covariance_db2: NDArray[np.float64]
    columns: NDArray[np.float64]  # (m, p); p = 0 where the mean is known
    # (p, p) and (p,). The information may be zero (a flat prior) where the intervals of finite
    # width determine delta.
    information: NDArray[np.float64]
    score: NDArray[np.float64]

    @staticmethod
    def known_mean(
        mean_db: NDArray[np.float64], covariance_db2: NDArray[np.float64]
    ) -> LatentPrior:
        """The prior N(mean, covariance)."""
        nothing = np.zeros((len(mean_db), 0))
        return LatentPrior(mean_db, covariance_db2, nothing, np.zeros((0, 0)), np.zeros(0))

    def integrated(self) -> tuple[LatentPrior, float]:
        """Delta integrated out, and the log of the integral of its density.

        Where `information` determines delta; EP's sweeps are then cheaper.
        """
        lower = lower_factor(self.information)
        moved = solve_lower(lower, self.columns.T)
        score = solve_lower(lower, self.score)
        log_integral = 0.5 * (float(score @ score) + len(score) * math.log(2.0 * math.pi))
        return (
            LatentPrior.known_mean(
                self.mean_db + moved.T @ score, self.covariance_db2 + moved.T @ moved
            ),
            log_integral - 0.5 * log_determinant(lower),
        )


@dataclass(frozen=True)
class IntervalSites:
    """The EP approximation of prior times the probability of the intervals."""

    mean_db: NDArray[np.float64]  # (m,) what the sites are relative to, the prior's mean
    # (m,) natural parameters: a site is proportional to exp(-precision (f - mean)^2 / 2 + shift (f
    # - mean))
    precision: NDArray[np.float64]
    shift: NDArray[np.float64]
    log_evidence: float  # EP's log of the integral of that product over f and delta
    evidence_slope: float  # Derivative of `log_evidence` by omega^2 through the likelihood alone

    def as_measurements(self) -> Sites:
        """The sites as Gaussian measurements of f."""
        precision = np.maximum(self.precision, 1.0 / MAX_SITE_VARIANCE_DB2)
        return Sites(self.mean_db + self.shift / precision, 1.0 / precision)


def rounded_variance_db2(resolution_db: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance r^2 / 12 that rounding to steps of r adds (Sheppard's correction)."""
    return resolution_db**2 / 12.0


def first_sites(
    limit_db: NDArray[np.float64], width_db: NDArray[np.float64], noise_variance_db2: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Precisions and shifts (m,) to begin with: the middles of the intervals, and no limits.

    `limit_db` and `width_db` as in :class:`Intervals`, relative to the mean.
    """
    precision = 1.0 / (noise_variance_db2 + rounded_variance_db2(width_db))
    return precision, precision * (limit_db - 0.5 * np.where(np.isinf(width_db), 0.0, width_db))


def matched_sites(
    mean_db: NDArray[np.float64],
    variance_db2: NDArray[np.float64],
    given: TruncatedNormal,
    noise_variance_db2: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Precisions and shifts (m,) of the sites that match cavities times interval likelihoods.

    With x the noisy power in units of the cavity's prediction, in which its variance given the
    interval is s^2, the site has precision (1 - s^2) / (omega^2 + s^2 v), v the cavity's variance:
    no difference of nearly equal numbers where the interval is narrow.
    """
    # Shapes: mean_db, variance_db2 (m,).
    shrink = np.maximum(1.0 - given.variance, 0.0)
    left = noise_variance_db2 + variance_db2 * given.variance
    width = np.sqrt(noise_variance_db2 + variance_db2)
    return shrink / left, (shrink * mean_db + given.mean * width) / left


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


MIN_NOISE_VARIANCE_DB2 = 1e-4
"""omega^2 is not taken below this, so that factors exist where positions repeat."""

FINE_STEP = 2.0
"""Steps r of the receiver's scale up to this multiple of omega are fine.

What Sheppard's Gaussian is wrong by there, against expectation propagation, with 300 measurements
of each of 40 channels: the slopes of the log likelihood by 0.06 of their deviations at most (0.1
with ten measurements to a place), the mean of the noise-free power by 0.015 of its own (0.03). With
ten to a place it soon gets worse: 0.6 and 0.17 at r = 3 omega; at 6 omega the slope by omega^2 is 3
deviations off, and errors are 1.5 times what the deviations say.
"""


def needs_site(measurements: Measurements, noise_variance_db2: float) -> NDArray[np.bool_]:
    """Return which are censored, or too coarsely rounded for Sheppard's correction; ``(n,)``.

    `noise_variance_db2` is omega^2.
    """
    finest = FINE_STEP * np.sqrt(noise_variance_db2)
    return measurements.censored | (measurements.resolution_db > finest)


def intervals(measurements: Measurements) -> Intervals:
    """Return each power's interval; censored ones are at most r / 2 above their value.

    Of a measurement that is neither censored nor rounded the interval is empty.
    """
    resolution = measurements.resolution_db
    width = np.where(measurements.censored, np.inf, resolution)
    return Intervals(measurements.power_dbm + 0.5 * resolution, width)


def gaussian_sites(parameters: ChannelParameters, measurements: Measurements) -> Sites:
    """Replace censored and rounded measurements by Gaussian ones, given the channel's parameters.

    The sites are conditioned jointly on all measurements: a censored one among strong neighbours
    pulls harder than one where a weak signal was expected anyway.
    """
    # Shapes: returns (n,).
    omega2 = parameters.multipath_std_db**2
    values = measurements.power_dbm.astype(np.float64)
    variances = omega2 + rounded_variance_db2(measurements.resolution_db)
    is_interval = needs_site(measurements, omega2)
    if is_interval.any():
        _put_sites(parameters, measurements, is_interval, values, variances)
    return Sites(values, variances)


@one_blas_thread()
def _put_sites(
    parameters: ChannelParameters,
    measurements: Measurements,
    is_interval: NDArray[np.bool_],
    values: NDArray[np.float64],
    variances: NDArray[np.float64],
) -> None:
    """Write the sites of those that `is_interval` (n,) to `values` and `variances` (n,)."""
    omega2 = max(parameters.multipath_std_db**2, MIN_NOISE_VARIANCE_DB2)
    theta = np.array([parameters.k_pl_db, parameters.n_pl])
    path_loss = regressors(measurements.positions_m, parameters.station) @ theta
    # A site is about what the receiver gets where it truly is.
    displaced = measured_path_loss_variance_db2(measurements, parameters)
    origins = measured_origins(measurements, parameters)
    at_interval = origins.at(np.flatnonzero(is_interval))
    mean = path_loss[is_interval]
    covariance = own_covariance_db2(at_interval, parameters)
    covariance.flat[:: len(covariance) + 1] += displaced[is_interval]
    if not is_interval.all():
        at_exact = origins.at(np.flatnonzero(~is_interval))
        exact_covariance = own_covariance_db2(at_exact, parameters)
        exact_covariance.flat[:: len(exact_covariance) + 1] += np.maximum(
            (variances + displaced)[~is_interval], MIN_NOISE_VARIANCE_DB2
        )
        lower = lower_factor(exact_covariance)
        half = solve_lower(lower, covariance_db2(at_exact, at_interval, parameters))
        mean = mean + half.T @ solve_lower(lower, (values - path_loss)[~is_interval])
        covariance = covariance - half.T @ half
    found = interval_sites(
        LatentPrior.known_mean(mean, covariance),
        intervals(measurements.take(is_interval)),
        omega2,
    ).as_measurements()
    values[is_interval] = found.values_db
    variances[is_interval] = found.noise_variance_db2
