"""Shadowing fields with the model's covariance, drawn exactly by circulant embedding.

The lattice is laid on a larger torus, whose covariance matrix the Fourier transform diagonalises.
Where the torus is too small some eigenvalues are negative; it is grown until the share that must
be clipped is negligible. A realisation is never standardised: that would destroy the covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError

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
    """Draw shadowing of covariance xi^2 exp(-d / beta) on a lattice (seed, section II).

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
        The decorrelation distance is so long for the cells that the torus does not fit into
        memory.
    """
    ny, nx = shape
    torus = (2 * ny, 2 * nx)
    while True:
        if torus[0] * torus[1] > MAX_TORUS_CELLS:
            raise InputError(
                f"a shadowing field of {ny} x {nx} cells of {cell_m:g} m with decorrelation "
                f"distance {decorrelation_m:g} m is too large to draw exactly",
                remedy="use larger cells or a shorter decorrelation distance",
            )
        eigenvalues = _torus_eigenvalues(torus, cell_m / decorrelation_m)
        clipped_share = float(np.maximum(-eigenvalues, 0.0).sum() / np.abs(eigenvalues).sum())
        if clipped_share <= CLIPPED_SHARE_TOLERANCE:
            break
        # The shorter side first: both must be long against the decorrelation distance.
        longer = math.ceil(GROWTH * min(torus))
        torus = (max(torus[0], longer), max(torus[1], longer))
    amplitude = np.sqrt(np.maximum(eigenvalues, 0.0) / eigenvalues.size)
    noise = generator.standard_normal(torus) + 1j * generator.standard_normal(torus)
    # Real and imaginary part are two independent fields; one is used.
    field = np.fft.fft2(amplitude * noise).real[:ny, :nx]
    padding = (torus[0] - ny, torus[1] - nx)
    return ShadowField(np.ascontiguousarray(shadow_std_db * field), padding, clipped_share)


def _torus_eigenvalues(torus: tuple[int, int], step: float) -> NDArray[np.float64]:
    """Eigenvalues of the unit-variance covariance on the torus, cells `step` decorrelations."""
    dy, dx = (np.minimum(np.arange(n), n - np.arange(n)) * step for n in torus)
    return np.fft.fft2(np.exp(-np.hypot(dy[:, None], dx[None, :]))).real
