"""A Cholesky factor that grows by rows without being copied."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import solve_lower

SOLVE_BLOCK = 128


class FactorBuffer:
    """Lower Cholesky factor with spare rows; rows from `used` on are free."""

    def __init__(self, capacity: int) -> None:
        self.lower: NDArray[np.float64] = np.zeros((capacity, capacity))
        self.used = 0


def spacious(count: int) -> int:
    """Capacity for `count` rows and more to come; zeroed pages cost nothing until written."""
    return count + count // 2 + 64


def whiten(lower: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """L^-1 `columns` (n, m), by blocks, because LAPACK would copy a view of a larger buffer."""
    solved = np.array(columns, dtype=np.float64)
    for start in range(0, len(lower), SOLVE_BLOCK):
        rows = slice(start, start + SOLVE_BLOCK)
        solved[rows] -= lower[rows, :start] @ solved[:start]
        solved[rows] = solve_lower(lower[rows, rows], solved[rows])
    return solved
