"""Groups of neighbouring measurements, each with others beside it: many small problems for one.

Measurements are cut into blocks of neighbours by medians. A window is a block with the measurements
nearest to it, either all (what the others say of the block) or those of blocks that come before it
(Vecchia's factorisation of a density into conditional ones). The order of blocks is from coarse to
fine: each next one is the farthest from those before. Everything depends on where the measurements
are, not on the order in which they are given, but for ties.

Sites of intervals window by window: expectation propagation at a cost linear in their number.

A site is matched against what all others say of its power
(:mod:`planopt.channel.intervals.expectation_propagation`). Here that is what a window around its
block says: the others of the block and the measurements beside it. With U the covariance of all in
the window, sites as measurements, what the others say of number i has mean
``y_i - (U^-1 y)_i / (U^-1)_ii`` and variance ``1 / (U^-1)_ii`` less the site's: one factor serves
the whole block.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import factor_and_whitened, lower_inverse
from planopt.channel.intervals.sites import (
    MAX_SITE_VARIANCE_DB2,
    Intervals,
    first_sites,
    matched_sites,
)
from planopt.channel.intervals.truncated_normal import truncated_normal
from planopt.channel.measurement_covariance import Origins, own_covariance_db2
from planopt.channel.parameters import ChannelParameters

BLOCK, BESIDE = 48, 128
"""Measurements of a block, and beside it in Vecchia's factorisation. On the three campus logs
(3,401 to 4,585 exact powers) the most likely xi, omega and beta are then within 0.07 standard
errors of those by one factor of all, and theta within 0.11; with 32 and 64 they were up to 0.46 and
0.24 off, and 64 and 192 take twice the time for no more."""

SITE_BESIDE = 64
"""Measurements beside a block whose sites are matched. At 1,500 measurements, 20 % to 70 %
censored, the sites' values are then off the joint ones by at most 0.01 of their own noise's
deviation rms, and 0.1 at worst."""

PRESELECTED = 4
"""Candidates by their distance from the block's box, as a multiple of those wanted; of these the
nearest to any of its members are taken."""


@dataclass(frozen=True, eq=False)
class Window:
    """A block of measurements and those it is conditioned on."""

    beside: NDArray[np.intp]  # (h,) numbers of the measurements it is conditioned on
    own: NDArray[np.intp]  # (b,) numbers of the block's

    @property
    def rows(self) -> NDArray[np.intp]:
        """``(h + b,)`` all of them, those beside first."""
        return np.concatenate([self.beside, self.own])


def place_blocks(coordinates: NDArray[np.float64], most: int) -> tuple[NDArray[np.intp], ...]:
    """Cut places (n, k) into blocks of `most` or few less; numbers ascend within each.

    Always along the widest side, so that blocks are compact.
    """
    blocks: list[NDArray[np.intp]] = []
    pending = [(np.arange(len(coordinates)), -(-len(coordinates) // most))]
    while pending:
        rows, parts = pending.pop()
        if parts <= 1:
            blocks.extend([np.sort(rows)] if len(rows) else [])
            continue
        widest = int(np.argmax(np.ptp(coordinates[rows], axis=0)))
        ranked = rows[np.argsort(coordinates[rows, widest], kind="stable")]
        cut = round(len(rows) * (parts // 2) / parts)
        pending += [(ranked[:cut], parts // 2), (ranked[cut:], parts - parts // 2)]
    return tuple(blocks)


def earlier_windows(
    coordinates: NDArray[np.float64], blocks: tuple[NDArray[np.intp], ...], count: int
) -> tuple[Window, ...]:
    """Order blocks from coarse to fine, and give each the `count` nearest of those before it."""
    # Shapes: coordinates (n, k).
    windows: list[Window] = []
    before = np.zeros(0, dtype=np.intp)
    for number in _coarse_to_fine(coordinates, blocks):
        own = blocks[number]
        windows.append(Window(_nearest_to(coordinates, own, before, count), own))
        before = np.concatenate([before, own])
    return tuple(windows)


def surrounding_windows(
    coordinates: NDArray[np.float64], blocks: tuple[NDArray[np.intp], ...], count: int
) -> tuple[Window, ...]:
    """Give each block the `count` nearest of all that are not in it."""
    everyone = np.arange(len(coordinates))
    windows: list[Window] = []
    for own in blocks:
        others = np.delete(everyone, own)
        windows.append(Window(_nearest_to(coordinates, own, others, count), own))
    return tuple(windows)


def _coarse_to_fine(
    coordinates: NDArray[np.float64], blocks: tuple[NDArray[np.intp], ...]
) -> list[int]:
    """Numbers of the blocks: the most central one, then always the farthest from all before."""
    if not blocks:
        return []
    centres = np.array([coordinates[own].mean(axis=0) for own in blocks])
    number = int(np.argmin(((centres - centres.mean(axis=0)) ** 2).sum(axis=1)))
    squared_m2 = np.full(len(blocks), np.inf)
    order: list[int] = []
    for _ in blocks:
        order.append(number)
        squared_m2 = np.minimum(squared_m2, ((centres - centres[number]) ** 2).sum(axis=1))
        # Those that are taken come last, whatever coincides with them.
        squared_m2[number] = -1.0
        number = int(np.argmax(squared_m2))
    return order


def _nearest_to(
    coordinates: NDArray[np.float64],
    own: NDArray[np.intp],
    others: NDArray[np.intp],
    count: int,
) -> NDArray[np.intp]:
    """Numbers of the `count` of `others` that are nearest to any of `own`; ascending."""
    for reach, distance in ((PRESELECTED * count, _beyond_box_m2), (count, _to_any_m2)):
        if len(others) > reach:
            squared_m2 = distance(coordinates[own], coordinates[others])
            others = others[np.argpartition(squared_m2, reach - 1)[:reach]]
    return np.sort(others)


def _beyond_box_m2(own: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distance of each of `others` (m, k) from the box around `own` (b, k); ``(m,)``."""
    low, high = own.min(axis=0), own.max(axis=0)
    beyond = np.maximum(np.maximum(low - others, others - high), 0.0)
    return np.einsum("mk,mk->m", beyond, beyond)


def _to_any_m2(own: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distance of each of `others` (m, k) from the nearest of `own` (b, k); ``(m,)``."""
    apart = others[:, None] - own
    return np.einsum("mbk,mbk->mb", apart, apart).min(axis=1)


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
    # (m,) natural parameters, as of :class:`planopt.channel.intervals.sites.IntervalSites`; the
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
