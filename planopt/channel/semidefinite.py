"""A triangular factor of covariances that may be singular: places that repeat, powers known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError

DETERMINED = 1e-10
"""A value counts as determined by earlier ones while its variance given them is below this share
of the largest variance: far above rounding, far below any variance of interest."""


def semidefinite_factor(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower triangular L with L L' = `covariance`; columns of determined values are zero."""
    # Shapes: covariance (h, h).
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        pass
    scale = float(np.diag(covariance).max())
    lower = np.zeros_like(covariance)
    for column in range(len(covariance)):
        rest = covariance[column:, column] - lower[column:, :column] @ lower[column, :column]
        if rest[0] > DETERMINED * scale:
            lower[column:, column] = rest / np.sqrt(rest[0])
    # What a determined value leaves undone is at most the root of its own remaining variance.
    if not np.abs(lower @ lower.T - covariance).max() <= 2.0 * np.sqrt(DETERMINED) * abs(scale):
        raise InputError(
            "the matrix is not a covariance: it is not positive semidefinite", key="covariance_db2"
        )
    return lower
