"""The rows of :mod:`~planopt.planning.programme.path_rows` and their gradients, in NumPy.

Residuals are computed from these, so that they do not rest on the solver's own derivatives.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def path_row_values(
    path_m: NDArray[np.float64], line: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values (m,) and gradients (m, 2 N) of all rows, m = N + N lines + (N - 1) lines.

    Parameters
    ----------
    path_m
        ``(N + 1, 2)`` the robot's own place first.
    line
        ``(N, lines, 4)`` normals, offsets at the segments' ends and at their starts.
    """
    n, lines = int(line.shape[0]), int(line.shape[1])
    steps = np.diff(path_m, axis=0)
    stage = np.arange(n)
    speed = np.zeros((n, n, 2))
    speed[stage, stage] = 2.0 * steps
    speed[stage[1:], stage[:-1]] = -2.0 * steps[1:]
    line_end = np.zeros((n, lines, n, 2))
    line_end[stage, :, stage] = line[:, :, :2]
    line_start = np.zeros((n - 1, lines, n, 2))
    line_start[stage[:-1], :, stage[:-1]] = line[1:, :, :2]
    jacobian = np.concatenate([b.reshape(-1, 2 * n) for b in (speed, line_end, line_start)])
    values = np.concatenate(
        [
            (steps**2).sum(1),
            (np.einsum("kji,ki->kj", line[:, :, :2], path_m[1:]) - line[:, :, 2]).ravel(),
            (np.einsum("kji,ki->kj", line[1:, :, :2], path_m[1:-1]) - line[1:, :, 3]).ravel(),
        ]
    )
    return values, jacobian
