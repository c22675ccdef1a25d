"""The restricted likelihood of any number of measurements, block by block, with gradient.

Vecchia's approximation: the density of all is the product over blocks of the density of a block
given measurements beside it that come before it (:mod:`planopt.channel.nearest.windows`). With L
the Cholesky factor of a window's covariance V, those beside first, and A the last rows of L^-1, the
block's, all that is needed are sums over windows,

    log |U| = sum 2 log diag(L)_block        C' U^-1 C = sum (A C)' (A C)

for the columns C = [y, X], and their derivatives. With D = A dV L'^-1, split into the columns of
those beside and of the block's own, and z = L^-1 C split likewise,

    dlog |U| = sum tr D_own        d(C' U^-1 C) = -sum (S + S'), S = z_own' (D_beside z_beside
                                                                      + D_own z_own / 2)

and the expected information is ``sum (<D_own, D_own> / 2 + <D_beside, D_beside>)`` (Guinness,
Statistics and Computing 31, 2021). The order of blocks depends on the places alone.

X has the columns of the mean, under a flat prior, and the indicators of the receivers but number 0,
whose coefficients have a normal one. Intervals are Gaussian sites
(:mod:`planopt.channel.nearest.windows`), and enter the gradient as in
:mod:`planopt.channel.estimation.restricted_likelihood`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import factor_and_inverse
from planopt.channel.estimation.least_squares import receiver_columns
from planopt.channel.estimation.likelihood_data import SITE_TOLERANCE, Covariance, Evaluated
from planopt.channel.gaussian_sites import intervals, rounded_variance_db2
from planopt.channel.measurement_covariance import (
    RECEIVER_OFFSET_STD_DB,
    Origins,
    ageing,
    measured_origins,
    measured_path_loss_variance_db2,
    own_distance_m,
)
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.window_sites import (
    SITE_BESIDE,
    IntervalRows,
    WindowSites,
    window_sites,
)
from planopt.channel.nearest.windows import (
    BESIDE,
    BLOCK,
    Window,
    earlier_windows,
    place_blocks,
    surrounding_windows,
)
from planopt.channel.parameters import ChannelParameters, MeanModel


@dataclass(frozen=True, eq=False)
class BlockData:
    """Measurements in windows."""

    known: ChannelParameters  # What is not estimated: the forgetting time, and the station
    # Of n measurements, every receiver's offset known: offsets are coefficients here
    origins: Origins
    # (n, q): the mean model's p columns, then the indicators of the receivers but number 0
    columns: NDArray[np.float64]
    prior_precision: NDArray[np.float64]  # (q,) of the coefficients: 0, flat, for the first p
    values_db: NDArray[np.float64]  # (n,) powers less the mean model's offset
    # (n,) variance beyond omega^2: of rounding, and of path loss by errors of position
    fixed_db2: NDArray[np.float64]
    # (n,): which are not intervals to the likelihood, and which are not censored
    gaussian: NDArray[np.bool_]
    measured: NDArray[np.bool_]
    intervals: IntervalRows | None  # Those that are; None where there are none
    log_steps: float  # Sum of the logarithms of the steps that coarse ones were rounded to
    windows: tuple[Window, ...]  # Blocks from coarse to fine, each with earlier ones beside it
    distances_m: tuple[NDArray[np.float64], ...]  # Within each window, position errors included


def block_data(
    model: MeanModel,
    measurements: Measurements,
    known: ChannelParameters,
    decorrelation_bounds_m: tuple[float, float],
    as_interval: NDArray[np.bool_] | None = None,
) -> BlockData:
    """Cut measurements into blocks and windows."""
    chosen = measurements.censored if as_interval is None else as_interval
    origins = measured_origins(measurements, known).without_offsets()
    coordinates = origins.positions_m
    if origins.time_s is not None:
        low, high = decorrelation_bounds_m
        distance_m = math.sqrt(low * high) / known.forgetting_s * origins.time_s
        coordinates = np.column_stack([coordinates, distance_m])
    blocks = place_blocks(coordinates, BLOCK)
    bands = intervals(measurements)
    rounded = np.where(chosen, 0.0, rounded_variance_db2(measurements.resolution_db))
    displaced = measured_path_loss_variance_db2(measurements, known)
    receivers = receiver_columns(measurements)
    windows = earlier_windows(coordinates, blocks, BESIDE)
    rows = np.flatnonzero(chosen)
    width = bands.width_db[rows]
    around = surrounding_windows(
        coordinates, tuple(own for own in blocks if chosen[own].any()), SITE_BESIDE
    )
    return BlockData(
        known,
        origins,
        np.column_stack([model.columns, receivers]),
        np.repeat([0.0, RECEIVER_OFFSET_STD_DB**-2], [model.columns.shape[1], receivers.shape[1]]),
        measurements.power_dbm - model.offset_db,
        rounded + displaced,
        ~chosen,
        ~measurements.censored,
        IntervalRows(
            rows,
            type(bands)(bands.upper_db[rows] - model.offset_db[rows], width),
            displaced[rows],
            around,
            _distances_m(origins, around),
        )
        if len(rows)
        else None,
        float(np.log(width[np.isfinite(width)]).sum()),
        windows,
        _distances_m(origins, windows),
    )


def exact_part(data: BlockData, blocks: int) -> BlockData:
    """The Gaussian measurements of the first blocks, which are spread over all places."""
    windows = data.windows[:blocks]
    taken = np.zeros(len(data.values_db), dtype=np.bool_)
    for window in windows:
        taken[window.own] = True
    taken &= data.gaussian
    rows = np.flatnonzero(taken)
    number = np.cumsum(taken) - 1
    kept = [
        Window(number[one.beside[taken[one.beside]]], number[one.own[taken[one.own]]])
        for one in windows
    ]
    kept = tuple(window for window in kept if len(window.own))
    origins = data.origins.at(rows)
    everyone = np.ones(len(rows), dtype=np.bool_)
    return BlockData(
        data.known,
        origins,
        data.columns[rows],
        data.prior_precision,
        data.values_db[rows],
        data.fixed_db2[rows],
        everyone,
        everyone,
        None,
        0.0,
        kept,
        _distances_m(origins, kept),
    )


def _distances_m(origins: Origins, windows: tuple[Window, ...]) -> tuple[NDArray[np.float64], ...]:
    return tuple(own_distance_m(origins.at(window.rows)) for window in windows)


MEAN_TOLERANCE = 0.03
"""Sites are matched again where the mean of an interval moved by more standard errors than this."""

ROUGH_TOLERANCE, ROUGH_SITE_TOLERANCE = 1e-2, 1e-3
"""Where log L may be off by the first, sites are matched once, to the second."""

DIFFERENCE = 0.3
"""Step of the differences of the gradient, in standard errors of the logarithms."""


@dataclass(frozen=True, eq=False)
class BlockEvaluation:
    """The restricted likelihood at one point.

    Attributes as of :class:`planopt.channel.estimation.likelihood_data.Evaluated`.
    """

    log_likelihood: float
    gradient: NDArray[np.float64]
    information: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    coefficient_covariance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Settled:
    """Sites and mean that were found at a point in logarithms."""

    logs: NDArray[np.float64]
    log_likelihood: float
    sites: WindowSites | None
    coefficients: NDArray[np.float64]


class BlockLikelihood:
    """The likelihood of measurements in windows; keeps sites and mean of two points to start from.

    Those are the last point and the best.
    """

    def __init__(self, data: BlockData) -> None:
        self._data = data
        known = data.measured
        line, *_ = np.linalg.lstsq(data.columns[known], data.values_db[known], rcond=None)
        nowhere = _Settled(np.zeros(3), -math.inf, None, np.asarray(line, dtype=np.float64))
        self._last = self._best = nowhere

    def at(self, covariance: Covariance, tolerance: float = 0.0) -> BlockEvaluation:
        """Evaluate it, intervals and the mean in turn until neither moves.

        Once each, if `tolerance` is at least `ROUGH_TOLERANCE`.
        """
        data, intervals = self._data, self._data.intervals
        rough = tolerance >= ROUGH_TOLERANCE
        logs = np.log(covariance)
        start = min((self._last, self._best), key=lambda one: np.abs(one.logs - logs).max())
        sites, coefficients = start.sites, start.coefficients
        values, noise = data.values_db, data.fixed_db2 + covariance[1]
        while True:
            if intervals is not None:
                sites = window_sites(
                    _with_covariance(data.known, covariance),
                    data.origins,
                    (values, noise),
                    intervals,
                    data.columns @ coefficients,
                    sites,
                    ROUGH_SITE_TOLERANCE if rough else SITE_TOLERANCE,
                )
                values, noise = values.copy(), noise.copy()
                values[intervals.rows] = sites.values_db
                noise[intervals.rows] = 1.0 / sites.precision + intervals.displaced_db2
            found = _sums(data, covariance, np.column_stack([values, data.columns]), noise)
            before, coefficients = coefficients, found.estimate(data.prior_precision)[0]
            if rough or intervals is None or self._is_still(coefficients - before, found):
                break
        evaluation = self._evaluation(found, sites)
        self._last = _Settled(logs, evaluation.log_likelihood, sites, coefficients)
        if self._last.log_likelihood > self._best.log_likelihood:
            self._best = self._last
        return evaluation

    def information(self, covariance: Covariance, at: Evaluated) -> NDArray[np.float64]:
        """The observed information, by differences of the gradient."""
        scale = np.array(covariance)
        logs = np.log(scale)
        steps = DIFFERENCE / (scale * np.sqrt(np.maximum(np.diag(at.information), scale**-2.0)))
        rows: list[NDArray[np.float64]] = []
        for axis, step in enumerate(np.diag(steps)):
            ends = [np.exp(logs + step), np.exp(logs - step)]
            above, below = (
                self.at((float(x), float(n), float(b)), ROUGH_TOLERANCE) for x, n, b in ends
            )
            slopes = above.gradient * ends[0] - below.gradient * ends[1]
            rows.append(-slopes / (2.0 * steps[axis]))
        curvature = np.array(rows)
        return 0.5 * (curvature + curvature.T) / np.outer(scale, scale)

    def _is_still(self, moved: NDArray[np.float64], found: _Sums) -> bool:
        """Return whether the mean of no interval moved far against its standard error."""
        data = self._data
        if data.intervals is None:
            return True
        columns = data.columns[data.intervals.rows]
        _, spread = found.estimate(data.prior_precision)
        deviation = np.sqrt(np.einsum("ij,jk,ik->i", columns, spread, columns))
        return bool((np.abs(columns @ moved) <= MEAN_TOLERANCE * deviation).all())

    def _evaluation(self, found: _Sums, sites: WindowSites | None) -> BlockEvaluation:
        """Put the sums together."""
        data = self._data
        coefficients, spread = found.estimate(data.prior_precision)
        flat = data.prior_precision == 0.0
        prior = data.prior_precision[~flat]
        squares = found.products[0, 0] - float(found.products[0, 1:] @ coefficients)
        log_likelihood = -0.5 * (
            found.log_determinant
            - float(np.linalg.slogdet(spread)[1])
            - float(np.log(prior).sum())
            + squares
            + (len(data.values_db) - int(flat.sum())) * math.log(2.0 * math.pi)
        )
        residual = np.concatenate([[1.0], -coefficients])
        slopes = found.product_slopes
        gradient: NDArray[np.float64] = -0.5 * (
            found.log_slopes
            + np.einsum("ij,kij->k", spread, slopes[:, 1:, 1:])
            + slopes @ residual @ residual
        )
        if sites is not None:
            log_likelihood += sites.log_factor - data.log_steps
            gradient[1] += sites.slope
        part = np.ix_(flat, flat)
        return BlockEvaluation(
            log_likelihood, gradient, found.information, coefficients[flat], spread[part]
        )


@dataclass(eq=False)
class _Sums:
    """Sums over windows: log |U|, C' U^-1 C, their derivatives, and the expected information."""

    log_determinant: float
    products: NDArray[np.float64]
    log_slopes: NDArray[np.float64]
    product_slopes: NDArray[np.float64]
    information: NDArray[np.float64]

    @staticmethod
    def nothing(columns: int) -> _Sums:
        """Return the sums of no window, for so many columns of the mean."""
        size = columns + 1
        return _Sums(
            0.0, np.zeros((size, size)), np.zeros(3), np.zeros((3, size, size)), np.zeros((3, 3))
        )

    def estimate(
        self, prior_precision: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Generalised least squares of the coefficients, and their covariance."""
        spread = np.asarray(
            np.linalg.inv(self.products[1:, 1:] + np.diag(prior_precision)), dtype=np.float64
        )
        return spread @ self.products[1:, 0], spread


def _sums(
    data: BlockData,
    covariance: Covariance,
    columns: NDArray[np.float64],
    noise_db2: NDArray[np.float64],
) -> _Sums:
    """Sum over the windows, for C = `columns` (n, q + 1) and noise (n,), sites as measurements."""
    sums = _Sums.nothing(columns.shape[1] - 1)
    # A rounded one's site has a variance that grows as omega^2, or nearly.
    coarse = bool((data.measured & ~data.gaussian).any())
    for window, distance_m in zip(data.windows, data.distances_m, strict=True):
        rows = window.rows
        correlation = np.exp(distance_m * (-1.0 / covariance[2]))
        if data.origins.time_s is not None:
            times = data.origins.time_s[rows]
            correlation *= ageing(times[:, None], times, data.known)
        _add(
            sums,
            len(window.own),
            covariance,
            (correlation, distance_m),
            columns[rows],
            noise_db2[rows],
            data.gaussian[rows],
            data.measured[rows] if coarse else None,
        )
    return sums


def _add(
    sums: _Sums,
    own: int,
    covariance: Covariance,
    geometry: tuple[NDArray[np.float64], NDArray[np.float64]],
    columns: NDArray[np.float64],
    noise_db2: NDArray[np.float64],
    gaussian: NDArray[np.bool_],
    measured: NDArray[np.bool_] | None,
) -> None:
    """Add one window, the last `own` of whose rows are its block's; the arrays are of its rows."""
    shadow, _, beta = covariance
    correlation, distance_m = geometry
    beside = len(noise_db2) - own
    total = shadow * correlation
    total.flat[:: len(total) + 1] += noise_db2
    diagonal, inverse = factor_and_inverse(total)
    rows = inverse[beside:]
    whitened = inverse @ columns
    before, here = whitened[:beside], whitened[beside:]
    sums.log_determinant += 2.0 * float(np.log(diagonal[beside:]).sum())
    sums.products += here.T @ here
    correlation *= distance_m
    parts = [rows * noise_db2, rows * gaussian, rows @ correlation]
    if measured is not None:
        parts.append(rows * measured)
    moved = (np.concatenate(parts) @ inverse.T).reshape(len(parts), own, -1)
    # The whitened covariance itself is the identity.
    moved[0] *= -1.0
    moved[0, np.arange(own), beside + np.arange(own)] += 1.0
    moved[0] /= shadow
    moved[2] *= shadow / beta**2
    within, across = moved[:3, :, beside:], moved[:3, :, :beside]
    sums.log_slopes += np.trace(within, axis1=1, axis2=2)
    half = here.T @ (across @ before + 0.5 * (within @ here))
    sums.product_slopes -= half + half.swapaxes(1, 2)
    if measured is not None:
        moved[1] = moved[3]
    within *= math.sqrt(0.5)
    flat = moved[:3].reshape(3, -1)
    sums.information += flat @ flat.T


def _with_covariance(known: ChannelParameters, covariance: Covariance) -> ChannelParameters:
    shadow, nugget, beta = covariance
    return replace(
        known,
        shadow_std_db=math.sqrt(shadow),
        multipath_std_db=math.sqrt(nugget),
        decorrelation_m=beta,
    )
