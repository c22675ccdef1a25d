"""Random shadowing fields with the model's covariance: on a lattice, scattered, or conditional.

A lattice is embedded in a torus (circulant embedding), which grows until the clipped share of
negative eigenvalues is negligible. A conditional field is an unconditional one plus the kriged
differences to the measured values, so no covariance between all cells is needed.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft as scipy_fft

from planopt.arrays import Floats, Indices
from planopt.channel.cholesky import lower_factor, one_blas_thread, solve_lower, solve_upper, whiten
from planopt.channel.kriging import PREDICTION_ELEMENTS
from planopt.channel.measurements import (
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

CLIPPED_SHARE_TOLERANCE = 1e-4
"""Maximum share of negative eigenvalues, which are clipped, in their sum."""

GROWTH = 1.25
MAX_TORUS_CELLS = 2**24

MAX_PLACES = 8_000  # Maximum number of distinct positions; a larger factor may not fit into memory
NUGGET = 1e-8
"""Share of xi^2 added to variances, so that a factor exists if positions nearly coincide."""
STENCIL = 4  # Side of the square of lattice nodes on which a value between them is conditioned
EARLIER = 16  # Number of nearest earlier positions on which a value between nodes is conditioned


@dataclass(frozen=True)
class ShadowField:
    """Realisation of shadowing on a lattice."""

    values_db: Floats  # (ny, nx)
    padding: tuple[int, int]  # Number of cells added to each axis, (y, x)
    clipped_share: float  # Share of negative eigenvalues, which were set to zero


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
        Numbers of nodes ``(ny, nx)``.
    cell_m
        Distance between neighbouring nodes in metres.
    shadow_std_db, decorrelation_m
        Standard deviation xi and decorrelation distance beta.
    generator
        Random number generator.

    Raises
    ------
    InputError
        A standard deviation, distance or cell side is invalid, or the torus does not fit into
        memory because the decorrelation distance is too long for the cells.
    """
    require_shadowing(shadow_std_db, decorrelation_m)
    if not (np.isfinite(cell_m) and cell_m > 0.0):
        raise InputError(
            f"is {cell_m!r}, should be above 0",
            key="cell_m",
            remedy="give the side of a cell in metres, e.g. 1",
        )
    ny, nx = shape
    (rows, columns), eigenvalues, clipped_share = _embedding(shape, cell_m / decorrelation_m)
    amplitude = np.sqrt(np.maximum(eigenvalues, 0.0) / (rows * columns))
    # The spectrum is even: frequencies k and n - k have the same eigenvalue.
    fold_y, fold_x = (np.minimum(np.arange(n), n - np.arange(n)) for n in (rows, columns))
    noise = np.empty((rows, columns), dtype=np.complex128)
    noise.real = generator.standard_normal((rows, columns))
    noise.imag = generator.standard_normal((rows, columns))
    noise *= amplitude[fold_y][:, fold_x]
    field = fft.fft(fft.fft(noise, axis=1)[:, :nx], axis=0)[:ny].real
    return ShadowField(shadow_std_db * field, (rows - ny, columns - nx), clipped_share)


def _embedding(
    shape: tuple[int, int],
    step: float,  # Cell side in decorrelation distances
) -> tuple[tuple[int, int], Floats, float]:
    """Return the torus' shape, a quarter of its eigenvalues, and the share of negative ones."""
    ny, nx = shape
    torus = (2 * ny, 2 * nx)
    while True:
        if torus[0] * torus[1] > MAX_TORUS_CELLS:
            raise InputError(
                f"a shadowing field of {ny} x {nx} cells with a decorrelation distance of "
                f"{1.0 / step:g} cells is too large to draw exactly",
                remedy="use larger cells or a shorter decorrelation distance",
            )
        # The covariance is even: a cosine transform of a quarter gives a quarter of the eigenvalues
        dy, dx = (np.arange(n // 2 + 1) * step for n in torus)
        eigenvalues = fft.dctn(np.exp(-np.hypot(dy[:, None], dx[None, :])), type=1)
        # Each frequency of the quarter counts twice, except the first and the last.
        weight_y, weight_x = (np.r_[1.0, np.full(n // 2 - 1, 2.0), 1.0] for n in torus)
        negative = weight_y @ np.maximum(-eigenvalues, 0.0) @ weight_x
        clipped_share = float(negative / (weight_y @ np.abs(eigenvalues) @ weight_x))
        if clipped_share <= CLIPPED_SHARE_TOLERANCE:
            return torus, eigenvalues, clipped_share
        # The shorter side first: both must be long compared with the decorrelation distance.
        longer = 2 * fft.next_fast_len((math.ceil(GROWTH * min(torus)) + 1) // 2)
        torus = (max(torus[0], longer), max(torus[1], longer))


def scattered_field_db(
    positions_m: ArrayLike,
    shadow_std_db: float,
    decorrelation_m: float,
    generator: np.random.Generator,
) -> Floats:
    """Draw shadowing of covariance xi^2 exp(-d / beta) at scattered positions (equation 1.2).

    Parameters
    ----------
    positions_m
        ``(n, 2)`` positions in metres; equal positions get equal values.
    shadow_std_db, decorrelation_m
        Standard deviation xi and decorrelation distance beta.
    generator
        Random number generator.

    Returns
    -------
    NDArray
        ``(n,)`` shadowing in dB.

    Raises
    ------
    InputError
        A standard deviation, distance or position is invalid, or there are more than `MAX_PLACES`
        distinct positions.
    """
    require_shadowing(shadow_std_db, decorrelation_m)
    places, back = _distinct(require_places(positions_m, at_least=0))
    if len(places) > MAX_PLACES:
        raise InputError(
            f"an exact shadowing field at {len(places)} positions is too large",
            remedy=f"use at most {MAX_PLACES} positions, or a field on a lattice",
        )
    factor = lower_factor(_correlation(places, decorrelation_m))
    return shadow_std_db * (factor @ generator.standard_normal(len(places)))[back]


def added_to_lattice_db(
    x_m: Floats,  # (nx,)
    y_m: Floats,  # (ny,)
    field_db: Floats,  # (ny, nx) of standard deviation xi
    positions_m: Floats,  # (n, 2), may repeat
    shadow_std_db: float,
    decorrelation_m: float,
    generator: np.random.Generator,
) -> Floats:
    """Draw shadowing (n,) in dB at positions (n, 2), conditional on a field on a lattice."""
    # Nearly exact within the lattice: near values screen far ones.
    places, back = _distinct(positions_m)
    columns, rows = _stencil(x_m, places[:, 0]), _stencil(y_m, places[:, 1])
    noise = generator.standard_normal(len(places))
    values = np.empty(len(places))
    for index, place in enumerate(places):
        east, north = np.meshgrid(x_m[columns[index]], y_m[rows[index]])
        nodes = np.column_stack([east.ravel(), north.ravel()])
        near = ((places[:index] - place) ** 2).sum(axis=1).argsort()[:EARLIER]
        there = np.concatenate([nodes, places[near]])
        at_nodes = field_db[np.ix_(rows[index], columns[index])].ravel()
        known = np.concatenate([at_nodes, values[near]])
        factor = lower_factor(_correlation(there, decorrelation_m))
        across = np.exp(-pairwise_distance_m(there, place[None]) / decorrelation_m)[:, 0]
        whitened = solve_lower(factor, np.column_stack([known, across]))
        mean = whitened[:, 0] @ whitened[:, 1]
        variance = max(0.0, 1.0 - float(whitened[:, 1] @ whitened[:, 1]))
        values[index] = mean + shadow_std_db * np.sqrt(variance) * noise[index]
    return values[back]


def _distinct(positions_m: Floats) -> tuple[Floats, Indices]:
    """Return the distinct positions and the index of each position among them."""
    places, back = np.unique(positions_m.reshape(-1, 2), axis=0, return_inverse=True)
    return places, back.reshape(-1)


def _correlation(places_m: Floats, decorrelation_m: float) -> Floats:
    """Return the correlation (n, n) of shadowing between places, with a nugget on the diagonal."""
    correlation = np.exp(-pairwise_distance_m(places_m, places_m) / decorrelation_m)
    correlation[np.diag_indices_from(correlation)] += NUGGET
    return correlation


def _stencil(axis_m: Floats, at_m: Floats) -> Indices:
    """Return indices of `STENCIL` nodes around each coordinate, or fewer on a short axis."""
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
    """Draw path loss and shadowing on a lattice, conditional on the measurements; no multipath.

    With theta drawn from its posterior, s an unconditional field and n drawn noise, the values are
    ``gamma theta + s + phi' U^-1 (y - Gamma theta - s_measured - n)``.

    Parameters
    ----------
    posterior
        Channel conditional on measurements.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``, covered by whole cells from the lower left corner.
    cell_m
        Cell side in metres.
    generator
        Random number generator.

    Raises
    ------
    InputError
        The lattice does not fit into memory, or measurements age.
    """
    parameters, measurements = posterior.parameters, posterior.measurements
    if posterior.origins.time_s is not None:
        raise InputError(
            "conditional fields cannot be drawn for measurements taken at different times",
            key="posterior",
            remedy="use sample_power, which is limited only by memory",
        )
    x_min, y_min, x_max, y_max = bounds_m
    x, y = cell_centres_m(x_min, x_max, cell_m), cell_centres_m(y_min, y_max, cell_m)
    covariance = (parameters.shadow_std_db, parameters.decorrelation_m)
    lattice = shadow_field_db((y.size, x.size), cell_m, *covariance, generator).values_db
    measured = measurements.positions_m
    places, std_m = measured, measurements.position_std_m
    if std_m.any():
        places = measured + std_m[:, None] * generator.standard_normal(measured.shape)
    at_measured = added_to_lattice_db(x, y, lattice, places, *covariance, generator)
    theta = generator.multivariate_normal(
        posterior.theta, posterior.theta_covariance, method="eigh"
    )
    noise = np.sqrt(posterior.noise_variance_db2) * generator.standard_normal(len(measured))
    residual = posterior.values_db - regressors(measured, parameters.station) @ theta
    residual -= at_measured + noise
    if measurements.receiver.any():
        numbers, which = np.unique(measurements.receiver, return_inverse=True)
        offsets = RECEIVER_OFFSET_STD_DB * generator.standard_normal(len(numbers))
        residual -= np.where(measurements.receiver == 0, 0.0, offsets[which])
    weights = solve_upper(posterior.factor, whiten(posterior.factor, residual[:, None])[:, 0])
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    values = lattice.ravel() + regressors(centres, parameters.station) @ theta
    block = max(1, PREDICTION_ELEMENTS // max(1, len(measured)))
    for start in range(0, len(centres), block):
        part = slice(start, start + block)
        across = shadow_covariance_db2(
            centres[part], measured, parameters, posterior.origins.blur_m2
        )
        values[part] += across @ weights
    return Raster(x, y, values.reshape(lattice.shape))
