# pyright: basic
"""Rows that a robot's dynamics add to a programme over a path, for CasADi and for NumPy alike.

Beside the positions q there are variables w: of each step the rest of the state after it and the
input of it. With the state x_k = (q_k, r_k), c a convex hull's points of a step's way, and lines
(n, b) as in :mod:`planopt.planning.programme.path_nlp`::

    step(x_{k-1}, u_k) - x_k   = 0     k = 1..N            "defect"
    limits(u_k, x_k)          <= 0     k = 1..N            "limit"
    stop_rows(x_N)             = 0                         "stop"
    n_kj . c_ki               >= b_kji k = 1..N, all i, j  "line_way"
    c_ki within the workspace          k = 1..N, all i     "box"

A line that keeps from something that moves has another offset at every point: I - 1 points of a way
belong to equal parts of the step, b_kji = (1 - i / I) a_kj + i / I b_kj. The way of stopping after
the last step is as another step, with lines of its own, which it keeps all the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.robots.drive import Drive
from planopt.robots.dynamics import Components, Dynamics


@dataclass(frozen=True)
class MotionShape:
    """The structure of the rows."""

    dynamics: Dynamics  # Of the robot, and the duration of a step
    step_s: float
    horizon: int  # N, and separating lines a segment
    lines: int

    @property
    def rest(self) -> int:
        """Components of the state beyond the place."""
        return len(self.dynamics.state_names) - 2

    @property
    def per_step(self) -> int:
        """Variables of a step."""
        return self.rest + len(self.dynamics.input_names)

    @property
    def variables(self) -> int:
        """Return all variables."""
        return self.horizon * self.per_step

    @property
    def parameters(self) -> int:
        """The rest of the state at the start, and the lines of the way of stopping."""
        return self.rest + 4 * self.lines

    def variables_of(self, drive: Drive) -> NDArray[np.float64]:
        """The variables w of a drive."""
        return np.hstack([drive.states[1:, 2:], drive.inputs]).ravel()

    def inputs_of(self, w: NDArray[np.float64]) -> NDArray[np.float64]:
        """``(N, m)`` inputs in variables w."""
        return w.reshape(self.horizon, self.per_step)[:, self.rest :]


@dataclass(frozen=True)
class MotionRows:
    """The rows by name, each a list of expressions or of arrays."""

    defect: list[Any]
    limit: list[Any]
    stop: list[Any]
    line_way: list[Any]
    box_x: list[Any]
    box_y: list[Any]

    def stacked(self) -> list[Any]:
        """Return all rows, in this order."""
        return [
            *self.defect,
            *self.limit,
            *self.stop,
            *self.line_way,
            *self.box_x,
            *self.box_y,
        ]

    def bounds(
        self, bounds_m: tuple[float, float, float, float]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper bounds of all rows; `bounds_m` is the workspace."""
        x_min, y_min, x_max, y_max = bounds_m
        parts = (
            (self.defect, 0.0, 0.0),
            (self.limit, -np.inf, 0.0),
            (self.stop, 0.0, 0.0),
            (self.line_way, 0.0, np.inf),
            (self.box_x, x_min, x_max),
            (self.box_y, y_min, y_max),
        )
        lower = [np.full(len(rows), low) for rows, low, _ in parts]
        upper = [np.full(len(rows), high) for rows, _, high in parts]
        return np.concatenate(lower), np.concatenate(upper)


def motion_rows(shape: MotionShape, q: Any, w: Any, start: Components, line: Any) -> MotionRows:
    """The rows of positions `q` and variables `w`."""
    # Shapes: q, w (2 N,).
    dynamics, step_s = shape.dynamics, shape.step_s
    rows = MotionRows([], [], [], [], [], [])
    before = start
    for k in range(shape.horizon):
        own = [w[k * shape.per_step + i] for i in range(shape.per_step)]
        control = tuple(own[shape.rest :])
        here = (q[2 * k], q[2 * k + 1], *own[: shape.rest])
        reached = dynamics.step(before, control, step_s)
        rows.defect.extend(there - at for there, at in zip(reached, here, strict=True))
        rows.limit.extend(dynamics.limits(control, here))
        _hull_rows(rows, shape, dynamics.control_points(before, control, step_s), line, k)
        before = here
    rows.stop.extend(dynamics.stop_rows(before, step_s))
    _hull_rows(rows, shape, dynamics.stop_points(before, step_s), line, shape.horizon)
    return rows


def _hull_rows(
    rows: MotionRows,
    shape: MotionShape,
    points: tuple[tuple[Any, Any], ...],
    line: Any,
    segment: int,
) -> None:
    """Return the rows that the points of one way must keep."""
    for number, (x, y) in enumerate(points, start=1):
        share = number / (len(points) + 1)
        for j in range(shape.lines):
            at = 4 * (segment * shape.lines + j)
            end, start = line[at + 2], line[at + 3]
            offset = end + (1.0 - share) * (start - end)
            rows.line_way.append(line[at] * x + line[at + 1] * y - offset)
        rows.box_x.append(x)
        rows.box_y.append(y)


def motion_row_values(
    shape: MotionShape,
    positions_m: NDArray[np.float64],
    w: NDArray[np.float64],
    start: NDArray[np.float64],
    line: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values (m,) of all rows and their gradients (m, 2 N + len(w))."""
    values, slopes = _row_functions(shape, len(line))(positions_m.ravel(), w, start, line)
    return np.asarray(values).ravel(), np.asarray(slopes)


@lru_cache(maxsize=64)
def _row_functions(shape: MotionShape, numbers: int) -> Any:
    """Values and gradients of the rows as a CasADi function of (q, w, start, line)."""
    import casadi as ca

    q, w = ca.SX.sym("q", 2 * shape.horizon), ca.SX.sym("w", shape.variables)
    start, line = ca.SX.sym("start", 2 + shape.rest), ca.SX.sym("line", numbers)
    rows = ca.vertcat(*motion_rows(shape, q, w, tuple(ca.vertsplit(start)), line).stacked())
    slopes = ca.densify(ca.jacobian(rows, ca.vertcat(q, w)))
    return ca.Function("rows", [q, w, start, line], [ca.densify(rows), slopes])
