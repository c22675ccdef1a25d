"""Powers known as intervals, and the Gaussian sites that stand for them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import log_determinant, lower_factor, solve_lower
from planopt.channel.intervals.truncated_normal import TruncatedNormal

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
