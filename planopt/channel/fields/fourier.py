# pyright: basic
"""Fourier transforms with types: the boundary to SciPy's, which ship none."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft as scipy_fft

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
