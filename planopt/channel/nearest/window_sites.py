"""Sites of intervals window by window: expectation propagation at a cost linear in their number.

A site is matched against what all others say of its power
(:mod:`planopt.channel.intervals.expectation_propagation`). Here that is what a window around its
block says: the others of the block and the measurements beside it. With U the covariance of all in
the window, sites as measurements, what the others say of number i has mean
``y_i - (U^-1 y)_i / (U^-1)_ii`` and variance ``1 / (U^-1)_ii`` less the site's: one factor serves
the whole block.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import lower_factor, lower_inverse, solve_lower
from planopt.channel.intervals.sites import (
    MAX_SITE_VARIANCE_DB2,
    Intervals,
    first_sites,
    matched_sites,
)
from planopt.channel.intervals.truncated_normal import truncated_normal
from planopt.channel.measurement_covariance import Origins, own_covariance_db2
from planopt.channel.nearest.windows import Window
from planopt.channel.parameters import ChannelParameters

MAX_SWEEPS = 60

AT_REST = 0.25
"""A block is passed over while nothing in its window moved by more than this share of the tolerance
when it was last looked at: after three sweeps that is true of half of them."""


@dataclass(frozen=True, eq=False)
class IntervalRows:
    """Measurements known to lie in an interval, among n.

    Attributes
    ----------
    rows
        ``(m,)`` their numbers, ascending.
    known
        Where their powers lie.
    displaced_db2
        ``(m,)`` variance of path loss from errors of their positions.
    windows
        Around every block that has some of them.
    """

    rows: NDArray[np.intp]
    known: Intervals
    displaced_db2: NDArray[np.float64]
    windows: tuple[Window, ...]


@dataclass(frozen=True, eq=False)
class WindowSites:
    """Gaussian sites of m measurements.

    Attributes
    ----------
    mean_db
        ``(m,)`` what `shift` is relative to.
    precision, shift
        ``(m,)`` natural parameters, as of :class:`planopt.channel.intervals.sites.IntervalSites`;
        the precision at least 1 / `MAX_SITE_VARIANCE_DB2`.
    log_factor
        Log of the product of the factors that turn Gaussian measurements into the sites: with it
        the density of all measurements, sites as such, is the probability of the intervals.
    slope
        Derivative of `log_factor` by omega^2 through the likelihood alone.
    """

    mean_db: NDArray[np.float64]
    precision: NDArray[np.float64]
    shift: NDArray[np.float64]
    log_factor: float
    slope: float

    @property
    def values_db(self) -> NDArray[np.float64]:
        """``(m,)`` the sites as measurements."""
        return self.mean_db + self.shift / self.precision


def window_sites(
    parameters: ChannelParameters,
    origins: Origins,
    gaussian: tuple[NDArray[np.float64], NDArray[np.float64]],
    intervals: IntervalRows,
    mean_db: NDArray[np.float64],
    start: WindowSites | None,
    tolerance: float,
) -> WindowSites:
    """Sweep over the windows until the sites reproduce themselves.

    Parameters
    ----------
    parameters
        xi, beta and omega > 0; theta is not used.
    origins
        Of n measurements.
    gaussian
        Values and noise ``(n,)`` of the Gaussian ones, what position errors do to path loss in the
        noise; those of intervals are not looked at.
    intervals
        The others.
    mean_db
        ``(n,)`` mean power.
    start
        Sites of a similar problem.
    tolerance
        They have converged when none moves by more than this in units of its posterior.
    """
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
        own_covariance_db2(origins.at(one.rows), parameters) for one in intervals.windows
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

    The variance is that of the measurement, its noise included.
    """
    lower = lower_factor(covariance)
    beside = len(lower) - own
    whitened = solve_lower(lower, about_db)[beside:]
    inverse = lower_inverse(lower[beside:, beside:])
    variance = 1.0 / np.einsum("ij,ij->j", inverse, inverse)[inside]
    weighted = (whitened @ inverse)[inside]
    return about_db[beside:][inside] - weighted * variance, variance


def _floored(precision: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.maximum(precision, 1.0 / MAX_SITE_VARIANCE_DB2)
