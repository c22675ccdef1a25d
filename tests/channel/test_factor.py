"""Solving by blocks of a triangular factor that is a part of a larger buffer."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.channel.factor import SOLVE_BLOCK, unwhiten, whiten


@pytest.mark.parametrize("size", [0, 1, SOLVE_BLOCK - 1, SOLVE_BLOCK, SOLVE_BLOCK + 1, 300])
def test_whitening_and_unwhitening_solve_the_system(size):
    """U x = b for U = L L', whatever the number of blocks; nothing outside the part is read."""
    rng = np.random.default_rng(size)
    buffer = np.full((size + 7, size + 7), np.nan)
    root = rng.normal(size=(size, size))
    matrix = root @ root.T + size * np.eye(size)
    buffer[:size, :size] = np.linalg.cholesky(matrix) if size else matrix
    right = rng.normal(size=(size, 3))
    lower = buffer[:size, :size]
    found = unwhiten(lower, whiten(lower, right))
    np.testing.assert_allclose(matrix @ found, right, atol=1e-9)
