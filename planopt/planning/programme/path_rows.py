# pyright: basic
"""Structure and constraint rows of the path programme, as CasADi expressions or NumPy arrays.

The rows of a single integrator are those of :mod:`planopt.planning.programme.path_nlp`. A robot
with dynamics has variables w in addition to the positions q: for each step the remaining components
r_k of the state x_k = (q_k, r_k) and the input u_k. Its rows, with control points c_ki of a step's
curve and lines (n, b), are::

    step(x_{k-1}, u_k) - x_k   = 0     k = 1..N            "defect"
    limits(u_k, x_k)          <= 0     k = 1..N            "limit"
    stop_rows(x_N)             = 0                         "stop"
    n_kj . c_ki               >= b_kji k = 1..N, all i, j  "line_way"
    c_ki within the workspace          k = 1..N, all i     "box"

A moving obstacle's line has a separate offset for each control point. The I - 1 points of a curve
are equally spaced in time, so b_kji = (1 - i / I) a_kj + i / I b_kj. Braking after the last step is
one more step with its own lines.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np

from planopt.arrays import Floats
from planopt.objectives.terms.term import Structure
from planopt.robots.dynamics import Components, Dynamics


@dataclass(frozen=True)
class MotionShape:
    """Sizes of the variables, parameters and constraint rows that describe a robot's dynamics."""

    dynamics: Dynamics
    step_s: float  # Duration of a step
    horizon: int
    lines: int  # Separating lines per segment

    @property
    def rest(self) -> int:
        """Return the number of state components besides the position."""
        return len(self.dynamics.state_names) - 2

    @property
    def per_step(self) -> int:
        """Return the number of variables per step."""
        return self.rest + len(self.dynamics.input_names)

    @property
    def variables(self) -> int:
        """Return the number of variables w of the dynamics."""
        return self.horizon * self.per_step

    @property
    def parameters(self) -> int:
        """Return the number of parameters: initial state without position, lines for braking."""
        return self.rest + 4 * self.lines


@dataclass(frozen=True)
class PathShape:
    """Structure of the nonlinear programme of a path."""

    horizon: int
    lines: int  # Separating lines per segment
    structure: Structure  # Coupling of the stages by the value
    bounded: bool = False  # Whether each stage's connectivity is bounded
    summed: bool = False  # Whether a sum over stages is bounded instead
    motion: MotionShape | None = None  # Rows of the dynamics; None for the single integrator
    charged: bool = False  # Whether a goal cost is subtracted, for a robot with dynamics
    slacked: bool = True  # Whether slacks may relax the connectivity bounds

    @property
    def bounds(self) -> int:
        """Return the number of connectivity rows: one per stage, one for a sum, or none."""
        return self.horizon if self.bounded else int(self.summed)

    @property
    def slacks(self) -> int:
        """Return the number of slacks: one per connectivity row, or none."""
        return self.bounds if self.slacked else 0

    @property
    def driven(self) -> int:
        """Return the number of variables of the robot's dynamics."""
        return 0 if self.motion is None else self.motion.variables

    @property
    def variables(self) -> int:
        """Return the number of all variables: positions, slacks, and those of the dynamics."""
        return 2 * self.horizon + self.slacks + self.driven

    @property
    def per_m(self) -> Floats:
        """Return the trust-region width of each variable per metre of a position; ``(variables,)``.

        The width is infinite for slacks and inputs, which the other variables determine.
        """
        places, slacks = np.ones(2 * self.horizon), np.full(self.slacks, np.inf)
        if self.motion is None:
            return np.concatenate([places, slacks])
        units = np.array(self.motion.dynamics.unit_m(self.motion.step_s)[2:])
        inputs = np.full(self.motion.per_step - len(units), np.inf)
        step = np.concatenate([1.0 / units, inputs])
        return np.concatenate([places, slacks, np.tile(step, self.horizon)])


def path_rows(n: int, lines: int, q: Any, start: Any, line: Any) -> Any:
    """Return the constraint rows "speed", "line_end" and "line_start" as one vector."""
    speed, line_end, line_start = [], [], []
    for k in range(n):
        here = q[2 * k : 2 * k + 2]
        before = start if k == 0 else q[2 * k - 2 : 2 * k]
        speed.append(ca.sumsqr(here - before))
        for j in range(lines):
            at = 4 * (k * lines + j)
            line_end.append(line[at] * here[0] + line[at + 1] * here[1] - line[at + 2])
            if k > 0:
                line_start.append(line[at] * before[0] + line[at + 1] * before[1] - line[at + 3])
    return ca.vertcat(*speed, *line_end, *line_start)


@dataclass(frozen=True)
class MotionRows:
    """Constraint rows of the dynamics, each kind as a list of expressions or numbers."""

    defect: list[Any]
    limit: list[Any]
    stop: list[Any]
    line_way: list[Any]
    box_x: list[Any]
    box_y: list[Any]

    def stacked(self) -> list[Any]:
        """Return all constraint rows in one list, in the order of the fields."""
        return [row for each in fields(self) for row in getattr(self, each.name)]

    def bounds(self, bounds_m: tuple[float, float, float, float]) -> tuple[Floats, Floats]:
        """Return lower and upper bounds of all constraint rows in the workspace `bounds_m`."""
        x_min, y_min, x_max, y_max = bounds_m
        limits = {
            "limit": (-np.inf, 0.0),
            "line_way": (0.0, np.inf),
            "box_x": (x_min, x_max),
            "box_y": (y_min, y_max),
        }
        each = [
            limits.get(own.name, (0.0, 0.0))
            for own in fields(self)
            for _ in getattr(self, own.name)
        ]
        lower, upper = np.array(each, dtype=np.float64).T
        return lower, upper


def motion_rows(shape: MotionShape, q: Any, w: Any, start: Components, line: Any) -> MotionRows:
    """Return the constraint rows of the dynamics for positions `q` (2 N,) and variables `w`."""
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
    """Append the rows that keep one curve in the workspace and beyond its separating lines."""
    for number, (x, y) in enumerate(points, start=1):
        share = number / (len(points) + 1)
        for j in range(shape.lines):
            at = 4 * (segment * shape.lines + j)
            end, start = line[at + 2], line[at + 3]
            offset = end + (1.0 - share) * (start - end)
            rows.line_way.append(line[at] * x + line[at + 1] * y - offset)
        rows.box_x.append(x)
        rows.box_y.append(y)
