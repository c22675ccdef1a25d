"""Expectation propagation window by window, at a cost linear in the number of measurements.

A site is matched against the cavity of its power
(:mod:`planopt.channel.gaussian_sites`), here computed from a window around its
block: the others of the block and the measurements next to it. With U the covariance of all in the
window, sites as measurements, the cavity of number i has mean ``y_i - (U^-1 y)_i / (U^-1)_ii`` and
variance ``1 / (U^-1)_ii`` less the site's: one factor serves the whole block. The fixed point is
that of :func:`planopt.channel.gaussian_sites.gaussian_sites`, but for the measurements outside
the window.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import factor_and_whitened, lower_inverse
from planopt.channel.gaussian_sites import (
    MAX_SITE_VARIANCE_DB2,
    MIN_NOISE_VARIANCE_DB2,
    Intervals,
    Sites,
    first_sites,
    intervals,
    matched_sites,
    needs_site,
    rounded_variance_db2,
    truncated_normal,
)
from planopt.channel.measurement_covariance import (
    Origins,
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.neighbours import BLOCK, Window, place_blocks, surrounding_windows
from planopt.channel.parameters import ChannelParameters, regressors

SITE_BESIDE = 64
"""Measurements beside a block whose sites are matched. At 1,500 measurements, 20 % to 70 %
censored, the sites' values are then off the joint ones by at most 0.01 of their own noise's
deviation rms, and 0.1 at worst."""

MAX_SWEEPS = 60

AT_REST = 0.25
"""A block is passed over while nothing in its window moved by more than this share of the tolerance
when it was last looked at: after three sweeps that is true of half of them."""


@dataclass(frozen=True, eq=False)
class IntervalRows:
    """Measurements known to lie in an interval, among n."""

    rows: NDArray[np.intp]  # (m,) their numbers, ascending
    known: Intervals  # Where their powers lie
    displaced_db2: NDArray[np.float64]  # (m,) variance of path loss from errors of their positions
    windows: tuple[Window, ...]  # Around every block that has some of them
    # Within each window, position errors included; None where they are asked for once only
    distances_m: tuple[NDArray[np.float64], ...] | None = None


def _distances_m(intervals: IntervalRows) -> Sequence[NDArray[np.float64] | None]:
    return intervals.distances_m or [None] * len(intervals.windows)


@dataclass(frozen=True, eq=False)
class WindowSites:
    """Gaussian sites of m measurements."""

    mean_db: NDArray[np.float64]  # (m,) what `shift` is relative to
    # (m,) natural parameters, as of :class:`planopt.channel.gaussian_sites.IntervalSites`; the
    # precision at least 1 / `MAX_SITE_VARIANCE_DB2`
    precision: NDArray[np.float64]
    shift: NDArray[np.float64]
    # Log of the product of the factors that turn Gaussian measurements into the sites: with it the
    # density of all measurements, sites as such, is the probability of the intervals
    log_factor: float
    slope: float  # Derivative of `log_factor` by omega^2 through the likelihood alone

    @classmethod
    def like(cls, values_db: NDArray[np.float64], noise_db2: NDArray[np.float64]) -> WindowSites:
        """Sites as measurements (m,), to start from; their factors are not known."""
        return cls(values_db, 1.0 / noise_db2, np.zeros_like(values_db), math.nan, math.nan)

    @property
    def values_db(self) -> NDArray[np.float64]:
        """``(m,)`` the sites as measurements."""
        return self.mean_db + self.shift / self.precision


def window_sites(
    parameters: ChannelParameters,
    origins: Origins,
    gaussian: tuple[NDArray[np.float64], NDArray[np.float64]],
    intervals: IntervalRows,
    mean_db: NDArray[np.float64],  # (n,) mean power
    start: WindowSites | None,
    tolerance: float,
) -> WindowSites:
    """Sweep over the windows until the sites reproduce themselves."""
    omega2 = parameters.multipath_std_db**2
    rows, mean = intervals.rows, mean_db[intervals.rows]
    limit = intervals.known.upper_db - mean
    width = intervals.known.width_db
    if start is None:
        precision, shift = first_sites(limit, width, omega2)
    else:
        precision, shift = start.precision, start.shift + start.precision * (start.mean_db - mean)
    precision, shift = _floored(precision), shift.copy()
    about, noise = gaussian[0] - mean_db, gaussian[1].copy()
    about[rows], noise[rows] = shift / precision, 1.0 / precision + intervals.displaced_db2
    place_of = np.full(len(mean_db), -1)
    place_of[rows] = np.arange(len(rows))
    covariances = [
        own_covariance_db2(origins.at(one.rows), parameters, distance_m)
        for one, distance_m in zip(intervals.windows, _distances_m(intervals), strict=True)
    ]
    # How far each has moved, and the logarithm of the factor and its slope by windows.
    moves, parts = np.zeros(len(mean_db)), np.zeros((len(covariances), 2))
    moves[rows] = np.inf
    step, last = 1.0, np.inf
    for _ in range(MAX_SWEEPS):
        error = 0.0
        for part, window, latent in zip(parts, intervals.windows, covariances, strict=True):
            if moves[window.rows].max() < AT_REST * tolerance:
                continue
            inside = np.flatnonzero(place_of[window.own] >= 0)
            numbers = window.own[inside]
            some = place_of[numbers]
            covariance = latent.copy()
            covariance.flat[:: len(covariance) + 1] += noise[window.rows]
            cavity_mean, cavity = _cavities(covariance, about[window.rows], len(window.own), inside)
            # The site's own noise is part of what was left out.
            cavity = np.maximum(cavity - 1.0 / precision[some], 1e-12)
            spread = np.sqrt(omega2 + cavity)
            given = truncated_normal((limit[some] - cavity_mean) / spread, width[some] / spread)
            found, moved = matched_sites(cavity_mean, cavity, given, omega2)
            found = _floored(found)
            # What is known of each power from the others and its own site.
            posterior = cavity / (1.0 + cavity * precision[some])
            moves[numbers] = np.maximum(
                np.abs((found - precision[some]) * posterior),
                np.abs((moved - shift[some]) * np.sqrt(posterior)),
            )
            error = max(error, float(moves[numbers].max()))
            shrink = np.maximum(1.0 - given.variance, 0.0)
            part[1] = 0.5 * float(((given.mean**2 - shrink) / (omega2 + cavity)).sum())
            precision[some] += step * (found - precision[some])
            shift[some] += step * (moved - shift[some])
            # With the sites as they are now: what changes the cavities later is of second order.
            total = cavity + 1.0 / precision[some]
            apart = shift[some] / precision[some] - cavity_mean
            part[0] = float(
                given.log_probability.sum()
                + 0.5 * (np.log(2.0 * np.pi * total) + apart**2 / total).sum()
            )
            about[numbers] = shift[some] / precision[some]
            noise[numbers] = 1.0 / precision[some] + intervals.displaced_db2[some]
        if error < tolerance:
            break
        # Sites that swing between sweeps are damped harder, for good.
        step = step if error < last else max(0.7 * step, 0.05)
        last = error
    log_factor, slope = (float(total) for total in parts.sum(axis=0))
    return WindowSites(mean, precision, shift, log_factor, slope)


def _cavities(
    covariance: NDArray[np.float64],
    about_db: NDArray[np.float64],
    own: int,
    inside: NDArray[np.intp],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and variance of the measurements `inside` the last `own` of a window, given the others.

    The variance is that of the measurement, its noise included; `covariance` is overwritten.
    """
    lower, whitened = factor_and_whitened(covariance, about_db)
    beside = len(lower) - own
    whitened = whitened[beside:]
    inverse = lower_inverse(np.tril(lower[beside:, beside:]))
    variance = 1.0 / np.einsum("ij,ij->j", inverse, inverse)[inside]
    weighted = (whitened @ inverse)[inside]
    return about_db[beside:][inside] - weighted * variance, variance


def _floored(precision: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.maximum(precision, 1.0 / MAX_SITE_VARIANCE_DB2)


TOLERANCE = 1e-3
"""Sites have converged when none moves by more than this in units of its posterior: less than what
the measurements left out change. It takes some ten sweeps."""


def neighbour_sites(
    parameters: ChannelParameters, measurements: Measurements, start: Sites | None = None
) -> Sites:
    """Replace censored and rounded measurements like `gaussian_sites`, each by its neighbours."""
    omega2 = parameters.multipath_std_db**2
    values = measurements.power_dbm.astype(np.float64)
    variances = omega2 + rounded_variance_db2(measurements.resolution_db)
    chosen = needs_site(measurements, omega2)
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return Sites(values, variances)
    omega2 = max(omega2, MIN_NOISE_VARIANCE_DB2)
    displaced = measured_path_loss_variance_db2(measurements, parameters)
    blocks = place_blocks(measurements.positions_m, BLOCK)
    found = window_sites(
        replace(parameters, multipath_std_db=math.sqrt(omega2)),
        measured_origins(measurements, parameters),
        (values, np.maximum(variances, MIN_NOISE_VARIANCE_DB2) + displaced),
        IntervalRows(
            rows,
            intervals(measurements.take(rows)),
            displaced[rows],
            surrounding_windows(
                measurements.positions_m,
                tuple(own for own in blocks if chosen[own].any()),
                SITE_BESIDE,
            ),
        ),
        regressors(measurements.positions_m, parameters.station)
        @ [parameters.k_pl_db, parameters.n_pl],
        None
        if start is None
        else WindowSites.like(start.values_db[rows], start.noise_variance_db2[rows]),
        TOLERANCE,
    )
    values[rows], variances[rows] = found.values_db, 1.0 / found.precision
    return Sites(values, variances)
