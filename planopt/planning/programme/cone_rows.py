"""Rows of a programme in NumPy: their values and gradients, and which of them are cones.

Residuals are computed from these values, so that they do not rest on the solver's own derivatives.
A row weight |z|^2 + constant <= upper, with z a pair of variables less another pair or a parameter,
is the cone |z| <= radius: it is convex as it is and need not be linearised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.programme.path_shape import PathShape


def path_row_values(
    path_m: NDArray[np.float64], line: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values (m,) and gradients (m, 2 N) of all rows, m = N + N lines + (N - 1) lines."""
    # Shapes: path_m (N + 1, 2); line (N, lines, 4).
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


NO_VARIABLE = -1
"""In place of a column."""


@dataclass(frozen=True, eq=False)
class ConeRows:
    """The rows of a programme that are cones."""

    row: NDArray[np.intp]  # (k,) their numbers
    # (k, 2) columns of the pairs of z, and of those that are taken from it; `NO_VARIABLE` where
    # that is none
    own: NDArray[np.intp]
    less: NDArray[np.intp]
    weight: NDArray[np.float64]  # (k,) of the row
    constant: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.row)

    def pairs(self, jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
        """``(k, 2)`` z where the rows' Jacobian (m, n) is taken: their gradients are 2 weight z."""
        return jacobian[self.row[:, None], self.own] / (2.0 * self.weight[:, None])

    def radii(self, upper: NDArray[np.float64]) -> NDArray[np.float64]:
        """``(k,)`` largest |z| under upper bounds (m,) of all rows."""
        return np.sqrt((upper[self.row] - self.constant) / self.weight)


def no_cones() -> ConeRows:
    """Return rows of which none is a cone."""
    return _rows([], [], [], [], [])


def step_cones(horizon: int) -> ConeRows:
    """The steps of a path, whose squared lengths are the first rows."""
    own = [(2 * k, 2 * k + 1) for k in range(horizon)]
    less = [(NO_VARIABLE, NO_VARIABLE), *own[:-1]]
    return _rows(list(range(horizon)), own, less, [1.0] * horizon, [0.0] * horizon)


def motion_cones(shape: PathShape) -> ConeRows:
    """Discs that inputs, or components of the state, must lie in."""
    motion = shape.motion
    if motion is None:
        return no_cones()
    dynamics, n = motion.dynamics, shape.horizon
    states, inputs = dynamics.state_names, dynamics.input_names
    columns = {name: column for column, name in enumerate((*states[2:], *inputs))}
    limits = len(dynamics.limits((1.0,) * len(inputs), (1.0,) * len(states)))
    first_row = n + 2 * n * shape.lines - shape.lines + n * len(states)
    first_column = 2 * n + shape.slacks
    row, own, weight = list[int](), list[tuple[int, int]](), list[float]()
    for k in range(n):
        for disc in dynamics.discs:
            row.append(first_row + k * limits + disc.limit)
            x, y = (first_column + k * motion.per_step + columns[name] for name in disc.names)
            own.append((x, y))
            weight.append(1.0 / disc.radius**2)
    none = [(NO_VARIABLE, NO_VARIABLE)] * len(row)
    return _rows(row, own, none, weight, [-1.0] * len(row))


def _rows(
    row: list[int],
    own: list[tuple[int, int]],
    less: list[tuple[int, int]],
    weight: list[float],
    constant: list[float],
) -> ConeRows:
    return ConeRows(
        np.array(row, dtype=np.intp),
        np.array(own, dtype=np.intp).reshape(-1, 2),
        np.array(less, dtype=np.intp).reshape(-1, 2),
        np.array(weight, dtype=np.float64),
        np.array(constant, dtype=np.float64),
    )
