"""Shadowing fields with the model's covariance, drawn exactly by circulant embedding.

The lattice is laid on a larger torus, whose covariance matrix the Fourier transform diagonalises.
Where the torus is too small some eigenvalues are negative; it is grown until the share that must
be clipped is negligible. A realisation is never standardised: that would destroy the covariance.
SciPy's transforms, which ship no types, are given some here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft as scipy_fft

from planopt.channel.places import require_shadowing
from planopt.errors import InputError

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
    """One realisation of shadowing.

    Attributes
    ----------
    values_db
        ``(ny, nx)``.
    padding
        Cells by which each axis was lengthened, ``(y, x)``.
    clipped_share
        Share of the eigenvalues' mass that was negative and set to zero.
    """

    values_db: NDArray[np.float64]
    padding: tuple[int, int]
    clipped_share: float


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
        raise InputError(f"{cell_m!r} m is no cell side", key="cell_m")
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
