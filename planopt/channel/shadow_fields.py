"""Shadowing fields with the model's covariance: on a lattice, at any places, given measurements.

The lattice is laid on a larger torus, whose covariance matrix the Fourier transform diagonalises.
Where the torus is too small some eigenvalues are negative; it is grown until the share that must
be clipped is negligible. A realisation is never standardised: that would destroy the covariance.

A field given measurements is an unconditional one, drawn at the places and at the measurements
alike, to which the kriged difference from the measured values is added (conditioning by kriging).
Its mean and covariance are those of the posterior, at the cost of one kriging for each draw and no
covariance between places. Drawn fields are of one time and at known places, so measurements of a
channel that forgets, or with errors of position, are refused.

SciPy's transforms, which ship no types, are given some here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft as scipy_fft

from planopt.channel.cholesky import lower_factor, one_blas_thread, solve_lower, solve_upper, whiten
from planopt.channel.kriging import PREDICTION_ELEMENTS
from planopt.channel.measurement_covariance import (
    RECEIVER_OFFSET_STD_DB,
    pairwise_distance_m,
    shadow_covariance_db2,
)
from planopt.channel.parameters import regressors, require_places, require_shadowing
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.world.raster import Raster, cell_centres_m

# SciPy's stubs describe its dispatch between backends, not its results.
fft: Any = scipy_fft


def even_spectrum(quarter: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform an even array, given and returned as a quarter.

    Of sides 2 (n - 1) and 2 (m - 1), the first n and m, at least 2, of every row and column.
    """
    return fft.dctn(quarter, type=1)


def transform_corner(values: NDArray[np.complex128], ny: int, nx: int) -> NDArray[np.complex128]:
    """The first `ny` rows and `nx` columns of the transform of `values`; the rest is left out."""
    return fft.fft(fft.fft(values, axis=1)[:, :nx], axis=0)[:ny]


def fast_even_length(least: int) -> int:
    """The next even number from `least` on that transforms fast."""
    return 2 * fft.next_fast_len((least + 1) // 2)


CLIPPED_SHARE_TOLERANCE = 1e-4
"""Eigenvalue mass that may be clipped, as a share of the whole: no covariance is then wrong by more
than this share of xi^2. Reached when the torus is about eight decorrelation distances long."""

GROWTH = 1.25
MAX_TORUS_CELLS = 2**24


@dataclass(frozen=True)
class ShadowField:
    """One realisation of shadowing."""

    values_db: NDArray[np.float64]  # (ny, nx)
    padding: tuple[int, int]  # Cells by which each axis was lengthened, (y, x)
    clipped_share: float  # Share of the eigenvalues' mass that was negative and set to zero


def shadow_field_db(
    shape: tuple[int, int],
    cell_m: float,
    shadow_std_db: float,
    decorrelation_m: float,
    generator: np.random.Generator,
) -> ShadowField:
    """Draw shadowing of covariance xi^2 exp(-d / beta) on a lattice (equation 1.2).

    Parameters
    ----------
    shape
        ``(ny, nx)``.
    cell_m
        Distance between neighbouring nodes.
    shadow_std_db, decorrelation_m
        xi and beta.
    generator
        Source of randomness.

    Raises
    ------
    InputError
        A deviation, distance or cell side is none, or the decorrelation distance is so long for
        the cells that the torus does not fit into memory.
    """
    return shadow_field_pair_db(shape, cell_m, shadow_std_db, decorrelation_m, generator)[0]


def shadow_field_pair_db(
    shape: tuple[int, int],
    cell_m: float,
    shadow_std_db: float,
    decorrelation_m: float,
    generator: np.random.Generator,
) -> tuple[ShadowField, ShadowField]:
    """Draw two independent fields at the cost of one; see :func:`shadow_field_db`.

    They are the real and the imaginary part of one transform, the first the one that
    :func:`shadow_field_db` draws.
    """
    require_shadowing(shadow_std_db, decorrelation_m)
    if not (np.isfinite(cell_m) and cell_m > 0.0):
        raise InputError(
            f"{cell_m!r} m is no cell side", key="cell_m", remedy="give a value above 0, e.g. 1"
        )
    ny, nx = shape
    (rows, columns), eigenvalues, clipped_share = _embedding(shape, cell_m / decorrelation_m)
    amplitude = np.sqrt(np.maximum(eigenvalues, 0.0) / (rows * columns))
    # The spectrum is even: frequencies k and n - k share an eigenvalue.
    fold_y, fold_x = (np.minimum(np.arange(n), n - np.arange(n)) for n in (rows, columns))
    amplitude = amplitude[fold_y][:, fold_x]
    noise = np.empty((rows, columns), dtype=np.complex128)
    noise.real = generator.standard_normal((rows, columns))
    noise.imag = generator.standard_normal((rows, columns))
    noise *= amplitude
    field = transform_corner(noise, ny, nx)
    padding = (rows - ny, columns - nx)
    first, second = (
        ShadowField(shadow_std_db * part, padding, clipped_share)
        for part in (field.real, field.imag)
    )
    return first, second


def _embedding(
    shape: tuple[int, int], step: float
) -> tuple[tuple[int, int], NDArray[np.float64], float]:
    """The torus, a quarter of its eigenvalues, and the share of their mass that is negative.

    `step` is a cell in decorrelation distances.
    """
    ny, nx = shape
    torus = (2 * ny, 2 * nx)
    while True:
        if torus[0] * torus[1] > MAX_TORUS_CELLS:
            raise InputError(
                f"a shadowing field of {ny} x {nx} cells with a decorrelation distance of "
                f"{1.0 / step:g} cells is too large to draw exactly",
                remedy="use larger cells or a shorter decorrelation distance",
            )
        eigenvalues = _torus_eigenvalues(torus, step)
        # Frequencies in the quarter stand for two each, but the first and the last.
        weight_y, weight_x = (np.r_[1.0, np.full(n // 2 - 1, 2.0), 1.0] for n in torus)
        negative = weight_y @ np.maximum(-eigenvalues, 0.0) @ weight_x
        clipped_share = float(negative / (weight_y @ np.abs(eigenvalues) @ weight_x))
        if clipped_share <= CLIPPED_SHARE_TOLERANCE:
            return torus, eigenvalues, clipped_share
        # The shorter side first: both must be long against the decorrelation distance.
        longer = fast_even_length(math.ceil(GROWTH * min(torus)))
        torus = (max(torus[0], longer), max(torus[1], longer))


def _torus_eigenvalues(torus: tuple[int, int], step: float) -> NDArray[np.float64]:
    """Eigenvalues of the unit-variance covariance on the torus, of even sides.

    The covariance is even, so that a cosine transform of a quarter of it gives a quarter of them.
    """
    dy, dx = (np.arange(n // 2 + 1) * step for n in torus)
    quarter = np.exp(-np.hypot(dy[:, None], dx[None, :]))
    return even_spectrum(quarter)


MAX_PLACES = 8_000
"""A factor of more rows would not fit the memory of a small machine."""

NUGGET = 1e-8
"""Share of xi^2 that keeps places that nearly coincide from breaking a factor: deviations of 1e-4
xi between them. Places that coincide share their value exactly."""

STENCIL = 4
"""Lattice nodes along a side of the square about a place that its value is drawn from."""

EARLIER = 16
"""Places drawn before that a place's value is drawn from, the nearest ones."""


def scattered_field_db(
    positions_m: ArrayLike,
    shadow_std_db: float,
    decorrelation_m: float,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw shadowing of covariance xi^2 exp(-d / beta) at any places (equation 1.2).

    Parameters
    ----------
    positions_m
        ``(n, 2)``, repeated ones included.
    shadow_std_db, decorrelation_m
        xi and beta.
    generator
        Source of randomness.

    Returns
    -------
    NDArray
        ``(n,)`` in dB.

    Raises
    ------
    InputError
        A deviation, a distance or a place is none, or there are more than `MAX_PLACES` different
        places.
    """
    require_shadowing(shadow_std_db, decorrelation_m)
    places, back = _distinct(require_places(positions_m, at_least=0))
    if len(places) > MAX_PLACES:
        raise InputError(
            f"{len(places)} places are too many for an exact field",
            remedy=f"use at most {MAX_PLACES}, or a field on a lattice",
        )
    factor = lower_factor(_correlation(places, decorrelation_m))
    return shadow_std_db * (factor @ generator.standard_normal(len(places)))[back]


def added_to_lattice_db(
    x_m: NDArray[np.float64],
    y_m: NDArray[np.float64],
    field_db: NDArray[np.float64],  # (ny, nx) of deviation xi
    positions_m: NDArray[np.float64],  # (n, 2), repeated ones included
    shadow_std_db: float,
    decorrelation_m: float,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw shadowing at places, given a field already drawn on a lattice.

    Each value is drawn given the lattice nodes about it and the nearest earlier places. With the
    exponential covariance nearer values screen farther ones, so that this is all but exact within
    the lattice; outside it correlation with nodes far from the nearest border is neglected.
    """
    # Shapes: x_m, y_m (nx,); returns (n,).
    places, back = _distinct(positions_m)
    columns, rows = _stencil(x_m, places[:, 0]), _stencil(y_m, places[:, 1])
    noise = generator.standard_normal(len(places))
    values = np.empty(len(places))
    for index, place in enumerate(places):
        east, north = np.meshgrid(x_m[columns[index]], y_m[rows[index]])
        nodes = np.column_stack([east.ravel(), north.ravel()])
        near = ((places[:index] - place) ** 2).sum(axis=1).argsort()[:EARLIER]
        there = np.concatenate([nodes, places[near]])
        known = np.concatenate(
            [field_db[np.ix_(rows[index], columns[index])].ravel(), values[near]]
        )
        factor = lower_factor(_correlation(there, decorrelation_m))
        across = np.exp(-pairwise_distance_m(there, place[None]) / decorrelation_m)[:, 0]
        whitened = solve_lower(factor, np.column_stack([known, across]))
        mean = whitened[:, 0] @ whitened[:, 1]
        variance = max(0.0, 1.0 - float(whitened[:, 1] @ whitened[:, 1]))
        values[index] = mean + shadow_std_db * np.sqrt(variance) * noise[index]
    return values[back]


def _distinct(positions_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Each place once, and where every position is among them."""
    places, back = np.unique(
        np.asarray(positions_m, dtype=np.float64).reshape(-1, 2), axis=0, return_inverse=True
    )
    return places, back.reshape(-1)


def _correlation(places_m: NDArray[np.float64], decorrelation_m: float) -> NDArray[np.float64]:
    """exp(-d / beta) with the nugget on its diagonal; (n, n)."""
    correlation = np.exp(-pairwise_distance_m(places_m, places_m) / decorrelation_m)
    correlation[np.diag_indices_from(correlation)] += NUGGET
    return correlation


def _stencil(axis_m: NDArray[np.float64], at_m: NDArray[np.float64]) -> NDArray[np.intp]:
    """Indices of the `STENCIL` nodes about each coordinate; fewer on a short axis, (n, size)."""
    size = min(STENCIL, len(axis_m))
    first = np.searchsorted(axis_m, at_m) - size // 2
    return np.clip(first, 0, len(axis_m) - size)[:, None] + np.arange(size)


@one_blas_thread()
def conditional_field(
    posterior: ChannelPosterior,
    bounds_m: tuple[float, float, float, float],
    cell_m: float,
    generator: np.random.Generator,
) -> Raster:
    """Draw path loss and shadowing on a lattice, given the measurements; no multipath.

    Parameters
    ----------
    posterior
        The channel given measurements. Where theta is estimated it is drawn too.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``, covered by whole cells from the lower left.
    cell_m
        Cell side.
    generator
        Source of randomness.

    Raises
    ------
    InputError
        The lattice is too large for its decorrelation distance, or the channel forgets, or the
        measurements have errors of position.
    """
    _require_one_time_and_known_places(posterior)
    parameters = posterior.parameters
    x_min, y_min, x_max, y_max = bounds_m
    x, y = cell_centres_m(x_min, x_max, cell_m), cell_centres_m(y_min, y_max, cell_m)
    covariance = (parameters.shadow_std_db, parameters.decorrelation_m)
    lattice = shadow_field_db((y.size, x.size), cell_m, *covariance, generator).values_db
    measured = posterior.measurements.positions_m
    at_measured = added_to_lattice_db(x, y, lattice, measured, *covariance, generator)
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    values = _conditioned(posterior, centres, lattice.ravel(), at_measured, generator)
    return Raster(x, y, values.reshape(lattice.shape))


@one_blas_thread()
def conditional_values_db(
    posterior: ChannelPosterior, positions_m: NDArray[np.float64], generator: np.random.Generator
) -> NDArray[np.float64]:
    """Draw path loss and shadowing at any places, given the measurements; no multipath."""
    # Shapes: positions_m (n, 2); returns (n,).
    _require_one_time_and_known_places(posterior)
    together = np.concatenate([positions_m, posterior.measurements.positions_m])
    parameters = posterior.parameters
    drawn = scattered_field_db(
        together, parameters.shadow_std_db, parameters.decorrelation_m, generator
    )
    count = len(positions_m)
    return _conditioned(posterior, positions_m, drawn[:count], drawn[count:], generator)


def _conditioned(
    posterior: ChannelPosterior,
    places_m: NDArray[np.float64],
    at_places_db: NDArray[np.float64],
    at_measured_db: NDArray[np.float64],
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Power gamma theta + s + phi' U^-1 (y - Gamma theta - s_measured - noise), theta drawn."""
    station, measured = posterior.parameters.station, posterior.measurements.positions_m
    theta = generator.multivariate_normal(
        posterior.theta, posterior.theta_covariance, method="eigh"
    )
    noise = np.sqrt(posterior.noise_variance_db2) * generator.standard_normal(len(measured))
    missed = posterior.values_db - regressors(measured, station) @ theta - at_measured_db - noise
    received = posterior.measurements.receiver
    if received.any():
        numbers, which = np.unique(received, return_inverse=True)
        offsets = RECEIVER_OFFSET_STD_DB * generator.standard_normal(len(numbers))
        missed -= np.where(received == 0, 0.0, offsets[which])
    weights = solve_upper(posterior.factor, whiten(posterior.factor, missed[:, None])[:, 0])
    values = at_places_db + regressors(places_m, station) @ theta
    block = max(1, PREDICTION_ELEMENTS // max(1, len(measured)))
    for start in range(0, len(places_m), block):
        part = slice(start, start + block)
        values[part] += (
            shadow_covariance_db2(places_m[part], measured, posterior.parameters) @ weights
        )
    return values


def _require_one_time_and_known_places(posterior: ChannelPosterior) -> None:
    """Refuse what a field drawn in the plane cannot be conditioned on."""
    origins = posterior.origins
    for part, what in ((origins.time_s, "that age"), (origins.blur_m2, "at uncertain places")):
        if part is not None:
            raise InputError(
                f"fields are not drawn given measurements {what}",
                key="posterior",
                remedy="use sample_power, for as many places as memory allows",
            )
