"""A Cholesky factor that grows by rows without being copied."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import put_lower_factor, solve_lower, solve_upper
from planopt.channel.measurement_covariance import Origins, covariance_db2, own_covariance_db2
from planopt.channel.parameters import ChannelParameters

SOLVE_BLOCK = 136
FACTOR_BLOCK = 264
"""Rows of powers of two meet in a few lines of the processor's cache: 256 took up to twice as
long."""

AT_ONCE = 768
"""Up to so many rows a factor is made in one piece."""


class FactorBuffer:
    """Lower Cholesky factor with spare rows; rows from `used` on are free."""

    def __init__(self, capacity: int) -> None:
        self.lower: NDArray[np.float64] = np.zeros((capacity, capacity))
        self.used = 0


def spacious(count: int) -> int:
    """Capacity for `count` rows and more to come; zeroed pages cost nothing until written."""
    return count + count // 2 + 64


def with_room(buffer: FactorBuffer | None, used: int, count: int) -> FactorBuffer:
    """A buffer for `count` rows whose first `used` ones are those of `buffer`.

    That itself where it has room and its free rows are not taken by another posterior.
    """
    if buffer is not None and buffer.used == used and len(buffer.lower) >= count:
        return buffer
    grown = FactorBuffer(spacious(count))
    if buffer is not None:
        grown.lower[:used, :used] = buffer.lower[:used, :used]
    grown.used = used
    return grown


def append_rows(
    buffer: FactorBuffer,
    parameters: ChannelParameters,
    origins: Origins,
    noise_variance_db2: NDArray[np.float64],  # (n,) variance of the noise of each
    columns: NDArray[np.float64],  # (n, c), whitened as far as the factor goes
) -> None:
    """Add the rows from `buffer.used` on to the factor, and whiten those of `columns` in place."""
    lower, count = buffer.lower, len(columns)
    block = AT_ONCE if count <= AT_ONCE else FACTOR_BLOCK
    for start in range(buffer.used, count, block):
        rows = slice(start, min(start + block, count))
        across = whiten(
            lower[:start, :start],
            covariance_db2(origins.at(slice(start)), origins.at(rows), parameters),
        )
        within = own_covariance_db2(origins.at(rows), parameters)
        within[np.diag_indices_from(within)] += noise_variance_db2[rows]
        if start:
            within -= across.T @ across
        lower[rows, :start] = across.T
        put_lower_factor(lower[rows, rows], within)
        columns[rows] = whiten(lower[rows, rows], columns[rows] - across.T @ columns[:start])
    buffer.used = count


def unwhiten(lower: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """L'^-1 `columns` (n, m), by blocks as :func:`whiten`; after it, U^-1 of what was whitened."""
    solved = np.array(columns, dtype=np.float64)
    for start in range((len(lower) - 1) // SOLVE_BLOCK * SOLVE_BLOCK, -1, -SOLVE_BLOCK):
        rows, below = slice(start, start + SOLVE_BLOCK), slice(start + SOLVE_BLOCK, None)
        solved[rows] -= lower[below, rows].T @ solved[below]
        solved[rows] = solve_upper(lower[rows, rows], solved[rows])
    return solved


def whiten(lower: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """L^-1 `columns` (n, m), by blocks, because LAPACK would copy a view of a larger buffer."""
    solved = np.array(columns, dtype=np.float64)
    for start in range(0, len(lower), SOLVE_BLOCK):
        rows = slice(start, start + SOLVE_BLOCK)
        solved[rows] -= lower[rows, :start] @ solved[:start]
        solved[rows] = solve_lower(lower[rows, rows], solved[rows])
    return solved
