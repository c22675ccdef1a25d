"""Approximations for long logs: Vecchia's likelihood, receiver offsets, intervals in windows.

Each measurement is conditioned on the nearest earlier ones (equation 1.18). Only products of the
whitened columns are stored, so adding a measurement costs the same however long the log is.
Receiver offsets have separate columns, because the nearest measurements may be from other receivers
(equation 1.15). With U the covariance of a window, sites included, the cavity of measurement
i has mean ``y_i - (U^-1 y)_i / (U^-1)_ii`` and variance ``1 / (U^-1)_ii`` less the site's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.cholesky import factor_and_inverse, factor_and_whitened, lower_inverse, whiten
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
from planopt.channel.measurements import (
    RECEIVER_OFFSET_STD_DB,
    Measurements,
    Origins,
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
)
from planopt.channel.neighbours import (
    BLOCK,
    BLOCK_NEIGHBOURS,
    PlaceIndex,
    Window,
    earlier_windows,
    later_windows,
    place_blocks,
    surrounding_windows,
)
from planopt.channel.parameters import ChannelParameters, regressors

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior

EARLIER_NEIGHBOURS = 64  # Number of earlier measurements that each new one is conditioned on


@dataclass(frozen=True, eq=False)
class VecchiaInformation:
    """Vecchia's approximation of the information on theta and the receiver offsets."""

    receivers: Indices  # (R,) receiver numbers, ascending, without 0
    # (3 + R, 3 + R) C' U0^-1 C with C = [y - Gamma theta_0, Gamma, Z], theta_0 from the
    # parameters, Z the receiver indicators and U0 the covariance without offsets
    products: Floats

    def path_loss_products(self) -> Floats:
        """Return products (3, 3) of whitened powers and regressors, offsets integrated out."""
        crossed = self.products[:3, 3:]
        return self.products[:3, :3] - crossed @ self.offset_covariance_db2() @ crossed.T

    def offset_covariance_db2(self) -> Floats:
        """Return the covariance (R, R) of the receiver offsets given theta."""
        prior = np.eye(len(self.receivers)) / RECEIVER_OFFSET_STD_DB**2
        return np.asarray(np.linalg.inv(self.products[3:, 3:] + prior), dtype=np.float64)


def vecchia_information(
    parameters: ChannelParameters,
    measurements: Measurements,  # n
    values_db: Floats,  # (n,) with sites for intervals
    noise_variance_db2: Floats,  # (n,) with sites for intervals
    before: tuple[VecchiaInformation, PlaceIndex] | None = None,  # Sums over the first ones
) -> VecchiaInformation:
    """Return the information from all `measurements`; `before` has sums over the first rows."""
    places = measurements.positions_m
    if before is None:
        windows = earlier_windows(places, place_blocks(places, BLOCK), BLOCK_NEIGHBOURS)
        receivers = np.unique(measurements.receiver)
    else:
        windows = later_windows(places, before[1], EARLIER_NEIGHBOURS)
        new = measurements.receiver[len(before[1].positions_m) :]
        receivers = np.union1d(before[0].receivers, new)
    receivers = receivers[receivers != 0]
    products = np.zeros((3 + len(receivers), 3 + len(receivers)))
    origins = measured_origins(measurements, parameters).without_offsets()
    for window in windows:
        rows = window.rows
        part = origins.at(rows)
        gamma = regressors(part.positions_m, parameters.station)
        centred = values_db[rows] - gamma @ [parameters.k_pl_db, parameters.n_pl]
        indicators = measurements.receiver[rows][:, None] == receivers
        covariance = own_covariance_db2(part, parameters)
        covariance.flat[:: len(rows) + 1] += noise_variance_db2[rows]
        _, inverse = factor_and_inverse(covariance)
        columns = np.column_stack([centred, gamma, indicators])
        whitened = inverse[len(window.near) :] @ columns
        products += whitened.T @ whitened
    if before is not None:
        kept = 3 + np.searchsorted(receivers, before[0].receivers)
        kept = np.concatenate([np.arange(3), kept])
        products[np.ix_(kept, kept)] += before[0].products
    return VecchiaInformation(receivers, products)


@dataclass(frozen=True)
class ReceiverOffset:
    """Estimated offset of a receiver's readings from those of receiver 0."""

    receiver: int  # Number of the receiver
    offset_db: float
    standard_error_db: float  # Includes the uncertainty of theta


@dataclass(frozen=True, eq=False)
class OffsetsGivenTheta:
    """Distribution of the offsets of R receivers given all measurements and theta."""

    # (R,) receiver numbers, ascending, without 0; empty if every measurement is from receiver 0
    receivers: Indices
    # (R, 3) s^2 Z' U^-1 [y, Gamma]: the mean is the first column minus the others times theta
    means_db: Floats
    covariance_db2: Floats  # (R, R) s^2 I - s^4 Z' U^-1 Z

    def indicators(self, receiver: Indices) -> Floats:
        """Return indicators (..., R), 1 where `receiver` (...) equals an entry of `receivers`."""
        return (receiver[..., None] == self.receivers).astype(np.float64)


def offsets_given_theta(posterior: ChannelPosterior) -> OffsetsGivenTheta:
    """Return the distribution of the receiver offsets given all measurements and theta."""
    if posterior.information is not None:
        # s^2 Z' U^-1 = V Z' U0^-1, with V the offsets' covariance.
        covariance = posterior.information.offset_covariance_db2()
        means = covariance @ posterior.information.products[3:, :3]
        theta = [posterior.parameters.k_pl_db, posterior.parameters.n_pl]
        # The products have y - Gamma theta_0 in place of y.
        means[:, 0] += means[:, 1:] @ theta
        return OffsetsGivenTheta(posterior.information.receivers, means, covariance)
    receiver = posterior.measurements.receiver
    receivers = np.unique(receiver[receiver != 0])
    if not len(receivers):
        return OffsetsGivenTheta(receivers, np.zeros((0, 3)), np.zeros((0, 0)))
    prior = RECEIVER_OFFSET_STD_DB**2
    whitened = whiten(posterior.factor, (receiver[:, None] == receivers).astype(np.float64))
    columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
    covariance = prior * np.eye(len(receivers)) - prior**2 * (whitened.T @ whitened)
    return OffsetsGivenTheta(receivers, prior * (whitened.T @ columns), covariance)


def receiver_offsets(posterior: ChannelPosterior) -> tuple[ReceiverOffset, ...]:
    """Return estimated offsets of all receivers except number 0, in ascending order.

    Without measurements from receiver 0 the offsets are known up to a common constant. The prior
    (mean 0, standard deviation `RECEIVER_OFFSET_STD_DB`) then fixes this constant, and the standard
    errors include its uncertainty.
    """
    found = offsets_given_theta(posterior)
    trend = found.means_db[:, 1:]
    means = found.means_db[:, 0] - trend @ posterior.theta
    covariance = found.covariance_db2 + trend @ posterior.theta_covariance @ trend.T
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(
        ReceiverOffset(int(receiver), float(mean), float(error))
        for receiver, mean, error in zip(found.receivers, means, errors, strict=True)
    )


SITE_NEIGHBOURS = 64
"""Number of neighbours of a block when sites are matched. For 1,500 measurements, 20 % to 70 % of
them censored, site values differ from joint ones by 0.01 standard deviations of their noise (RMS)
and by 0.1 at most."""

MAX_SWEEPS = 60

AT_REST = 0.25  # Share of the tolerance below which a block is skipped
TOLERANCE = 1e-3
"""Tolerance in standard deviations of a site's posterior; it takes about ten sweeps."""


@dataclass(frozen=True, eq=False)
class IntervalRows:
    """Indices of the interval measurements, and the windows in which sites are matched."""

    rows: Indices  # (m,) indices, ascending
    known: Intervals
    displaced_db2: Floats  # (m,) variance of path loss due to position errors
    windows: tuple[Window, ...]  # One for each block with interval measurements
    # Distances within each window, position errors included; None to compute them once
    distances_m: tuple[Floats, ...] | None = None


@dataclass(frozen=True, eq=False)
class WindowSites:
    """Gaussian sites of m measurements."""

    mean_db: Floats  # (m,) origin of the sites
    # (m,) natural parameters; the precision is at least 1 / `MAX_SITE_VARIANCE_DB2`
    precision: Floats
    shift: Floats
    # Log of P(intervals) over the density of the measurements with sites
    log_factor: float
    slope: float  # Derivative of `log_factor` with respect to omega^2, with sites fixed

    @property
    def values_db(self) -> Floats:
        """Values of the sites as measurements, ``(m,)``."""
        return self.mean_db + self.shift / self.precision


def window_sites(
    parameters: ChannelParameters,
    origins: Origins,
    gaussian: tuple[Floats, Floats],  # (n,) values, noise variances
    intervals: IntervalRows,
    mean_db: Floats,  # (n,) mean power
    start: WindowSites | None,
    tolerance: float,
) -> WindowSites:
    """Fit a Gaussian site to each interval; sweep over all windows until convergence."""
    omega2 = max(parameters.white_variance_db2, MIN_NOISE_VARIANCE_DB2)
    rows, mean = intervals.rows, mean_db[intervals.rows]
    limit = intervals.known.upper_db - mean
    width = intervals.known.width_db
    if start is None:
        precision, shift = first_sites(limit, width, omega2)
    else:
        precision, shift = start.precision, start.shift + start.precision * (start.mean_db - mean)
    precision, shift = np.maximum(precision, 1.0 / MAX_SITE_VARIANCE_DB2), shift.copy()
    centred, noise = gaussian[0] - mean_db, gaussian[1].copy()
    centred[rows], noise[rows] = shift / precision, 1.0 / precision + intervals.displaced_db2
    site_of = np.full(len(mean_db), -1)
    site_of[rows] = np.arange(len(rows))
    covariances = [
        own_covariance_db2(origins.at(window.rows), parameters, distance_m)
        for window, distance_m in zip(
            intervals.windows, intervals.distances_m or [None] * len(intervals.windows), strict=True
        )
    ]
    # Last change of each measurement; log factor and slope of each window.
    moves, parts = np.zeros(len(mean_db)), np.zeros((len(covariances), 2))
    moves[rows] = np.inf
    step, last = 1.0, np.inf
    for _ in range(MAX_SWEEPS):
        error = 0.0
        for part, window, latent in zip(parts, intervals.windows, covariances, strict=True):
            if moves[window.rows].max() < AT_REST * tolerance:
                continue
            own = np.flatnonzero(site_of[window.own] >= 0)
            numbers = window.own[own]
            sites = site_of[numbers]
            covariance = latent.copy()
            covariance.flat[:: len(covariance) + 1] += noise[window.rows]
            # Leave-one-out means and variances; the left-out measurement includes its site's noise.
            lower, whitened = factor_and_whitened(covariance, centred[window.rows])
            near = len(lower) - len(window.own)
            inverse = lower_inverse(np.tril(lower[near:, near:]))
            cavity = 1.0 / np.einsum("ij,ij->j", inverse, inverse)[own]
            cavity_mean = centred[numbers] - (whitened[near:] @ inverse)[own] * cavity
            cavity = np.maximum(cavity - 1.0 / precision[sites], 1e-12)
            spread = np.sqrt(omega2 + cavity)
            inside = truncated_normal((limit[sites] - cavity_mean) / spread, width[sites] / spread)
            found, moved = matched_sites(cavity_mean, cavity, inside, omega2)
            found = np.maximum(found, 1.0 / MAX_SITE_VARIANCE_DB2)
            # Variance of each power given all sites, its own included.
            posterior = cavity / (1.0 + cavity * precision[sites])
            moves[numbers] = np.maximum(
                np.abs((found - precision[sites]) * posterior),
                np.abs((moved - shift[sites]) * np.sqrt(posterior)),
            )
            error = max(error, float(moves[numbers].max()))
            shrink = np.maximum(1.0 - inside.variance, 0.0)
            part[1] = 0.5 * float(((inside.mean**2 - shrink) / (omega2 + cavity)).sum())
            precision[sites] += step * (found - precision[sites])
            shift[sites] += step * (moved - shift[sites])
            # Computed with the new sites; later changes of the cavities are of second order.
            total = cavity + 1.0 / precision[sites]
            apart = shift[sites] / precision[sites] - cavity_mean
            part[0] = float(
                inside.log_probability.sum()
                + 0.5 * (np.log(2.0 * np.pi * total) + apart**2 / total).sum()
            )
            centred[numbers] = shift[sites] / precision[sites]
            noise[numbers] = 1.0 / precision[sites] + intervals.displaced_db2[sites]
        if error < tolerance:
            break
        # Sites that oscillate between sweeps are damped more, permanently.
        step = step if error < last else max(0.7 * step, 0.05)
        last = error
    log_factor, slope = (float(total) for total in parts.sum(axis=0))
    return WindowSites(mean, precision, shift, log_factor, slope)


def neighbour_sites(
    parameters: ChannelParameters, measurements: Measurements, start: Sites | None = None
) -> Sites:
    """Return the sites of :func:`gaussian_sites`, approximated window by window."""
    omega2 = parameters.white_variance_db2
    values = measurements.power_dbm.astype(np.float64)
    variances = omega2 + rounded_variance_db2(measurements.resolution_db)
    chosen = needs_site(measurements, omega2)
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return Sites(values, variances)
    displaced = measured_path_loss_variance_db2(measurements, parameters)
    positions, theta = measurements.positions_m, [parameters.k_pl_db, parameters.n_pl]
    blocks = tuple(own for own in place_blocks(positions, BLOCK) if chosen[own].any())
    initial = None
    if start is not None:
        precision = 1.0 / start.noise_variance_db2[rows]
        shift = np.zeros(len(rows))
        initial = WindowSites(start.values_db[rows], precision, shift, math.nan, math.nan)
    found = window_sites(
        parameters,
        measured_origins(measurements, parameters),
        (values, np.maximum(variances, MIN_NOISE_VARIANCE_DB2) + displaced),
        IntervalRows(
            rows,
            intervals(measurements.take(rows)),
            displaced[rows],
            surrounding_windows(positions, blocks, SITE_NEIGHBOURS),
        ),
        regressors(positions, parameters.station) @ theta,
        initial,
        TOLERANCE,
    )
    values[rows], variances[rows] = found.values_db, 1.0 / found.precision
    return Sites(values, variances)
