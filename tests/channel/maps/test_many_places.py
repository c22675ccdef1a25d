"""Whitened rows of many places against dense solves."""

import numpy as np
import pytest

from planopt.channel.kriging import INVERT_BELOW, RowWhitener


@pytest.mark.parametrize("count", [1, INVERT_BELOW - 1, INVERT_BELOW])
def test_rows_are_reduced(count):
    """What rows tell of columns and variance, by dense solves, with and without the inverse."""
    generator = np.random.default_rng(0)
    root = generator.standard_normal((count, count))
    lower = np.linalg.cholesky(root @ root.T / count + np.eye(count))
    columns, rows = generator.standard_normal((count, 3)), generator.standard_normal((7, count))
    whitened = np.linalg.solve(lower, rows.T)
    projected, explained = RowWhitener(lower, columns).reduce(rows.copy())
    np.testing.assert_allclose(projected, columns.T @ whitened, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(explained, (whitened**2).sum(axis=0), rtol=1e-10)
