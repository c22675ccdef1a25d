"""Refine a start path for any smooth value: same homotopy class, continuous places.

The data of a robot with dynamics are arrays of the same solver; for the single integrator they are
empty.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Termination
from planopt.planning.programme.goal_value import GoalCharge, goal_cost_gradient
from planopt.planning.programme.margin_source import EvaluatePath
from planopt.planning.programme.motion_rows import MotionShape, motion_row_values, motion_rows
from planopt.planning.programme.nlp_functions import (
    Bounds,
    NlpPoint,
    kkt_residual,
    named_multipliers,
)
from planopt.planning.programme.path_nlp import PathNlp
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.robots.drive import Drive
from planopt.world.separation import SeparatingLines


def _none() -> NDArray[np.float64]:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class MotionTask:
    """The start of a refinement."""

    shape: MotionShape  # Structure of the rows
    drive: Drive  # Along the start path, from the robot's state on
    stop_lines: SeparatingLines  # Separating lines of the way of stopping after it, of one segment


@dataclass(frozen=True, eq=False)
class MotionNumbers:
    """A task as arrays; all empty for the single integrator."""

    start: NDArray[np.float64] = field(default_factory=_none)  # First guess of the variables w
    # What the solver is told beside the lines of the path
    parameters: NDArray[np.float64] = field(default_factory=_none)
    rows: Bounds = field(default_factory=lambda: Bounds(_none(), _none()))  # Bounds of the rows
    task: MotionTask | None = None  # What it is of, and all lines, flat
    line: NDArray[np.float64] = field(default_factory=_none)

    def values(
        self, positions_m: NDArray[np.float64], w: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values (m,) of the rows and gradients (m, 2 N + len(w)), without CasADi."""
        if self.task is None:
            return _none(), np.zeros((0, positions_m.size))
        state = self.task.drive.states[0]
        return motion_row_values(self.task.shape, positions_m, w, state, self.line)

    def gradient(
        self,
        positions_m: NDArray[np.float64],
        w: NDArray[np.float64],
        charge: GoalCharge | None,
    ) -> NDArray[np.float64]:
        """Return the gradient of the way's cost (2 N + len(w),); zero where none is charged."""
        if self.task is None or charge is None:
            return np.zeros(positions_m.size + len(w))
        state = self.task.drive.states[0]
        return goal_cost_gradient(self.task.shape, positions_m, w, state, charge)


def motion_numbers(
    task: MotionTask | None,
    line: NDArray[np.float64],
    stop_line: NDArray[np.float64],
    bounds_m: tuple[float, float, float, float],
) -> MotionNumbers:
    """The arrays of a task."""
    # Shapes: line, stop_line (N, lines, 4).
    if task is None:
        return MotionNumbers()
    shape, drive = task.shape, task.drive
    start = shape.variables_of(drive)
    every = np.concatenate([line.ravel(), stop_line.ravel()])
    state = tuple(drive.states[0])
    rows = motion_rows(shape, drive.states[1:, :2].ravel(), start, state, every)
    return MotionNumbers(
        start=start,
        parameters=np.concatenate([drive.states[0, 2:], stop_line.ravel()]),
        rows=Bounds(*rows.bounds(bounds_m)),
        task=task,
        line=every,
    )


@dataclass(frozen=True)
class RefinedPath:
    """The result of a refinement."""

    path_m: NDArray[np.float64]  # (N, 2); only worth something if a verifier says so
    slack_db: NDArray[np.float64]  # (N,) missing dB
    termination: Termination  # Why the solver stopped, after how many iterations
    iterations: int
    kkt_residual: float  # Unscaled, computed without the solver's derivatives
    # By name: speed (N,), line_end (N, lines), line_start (N - 1, lines), connectivity (N,)
    multipliers: dict[str, NDArray[np.float64]]
    # (N, m) of a robot that cannot turn or stop at will; None of a single integrator
    inputs: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class PathTask:
    """The task of one refinement."""

    start_m: NDArray[np.float64]  # (2,) where the robot is
    path_m: NDArray[np.float64]  # (N, 2) the start path
    lines: SeparatingLines  # Separating lines of the start path's N segments
    clearance_m: float  # Limits
    step_length_m: float
    bounds_m: tuple[float, float, float, float]  # The workspace (x_min, y_min, x_max, y_max)
    evaluate: EvaluatePath  # Value and margins by path
    scale: float  # What a unit of value counts in the solver, so that its tolerances mean something
    # (N,) what the margins must reach, or None where no connectivity is bounded
    bound_db: NDArray[np.float64] | None = None
    # (N,) how much of it may be missing; zero where the bound is hard. (1,) of a total.
    slack_limit_db: NDArray[np.float64] | None = None
    slack_weight: float = 0.0  # Cost of a missing dB
    # What the sum over stages must reach, or None where none is bounded
    total_bound: float | None = None
    total_per_db: float = 0.0  # What a dB of slack adds to it
    motion: MotionTask | None = None  # Of the robot's dynamics; None for the single integrator
    charge: GoalCharge | None = None  # Of the way to a goal; None where none is charged
    # Step (1..N) from which on the start path stands still and so does the refined one; None if it
    # moves to its end
    arrival: int | None = None


def polish_path(nlp: PathNlp, task: PathTask) -> RefinedPath:
    """Solve the programme from the task's start path."""
    shape = nlp.shape
    n = shape.horizon
    bound = np.zeros(0) if task.bound_db is None else task.bound_db
    if task.total_bound is not None:
        bound = np.append(bound, task.total_bound)
    slack_limit = np.zeros(shape.slacks) if task.slack_limit_db is None else task.slack_limit_db
    pad = 0.0 if shape.motion is None else shape.motion.dynamics.hull_pad_m(shape.motion.step_s)
    kept = task.clearance_m + pad + CLEARANCE_PAD_M
    line = task.lines.rows(kept)
    stop = np.zeros((0, shape.lines, 4))
    if task.motion is not None:
        stop = task.motion.stop_lines.rows(kept)
    motion = motion_numbers(task.motion, line, stop, task.bounds_m)
    free = np.full(len(motion.start), np.inf)
    head = np.array([*task.start_m, task.scale, task.slack_weight, task.total_per_db])
    lower, upper = _position_bounds(task, n)
    variables = Bounds(
        np.concatenate([lower, np.zeros(shape.slacks), -free]),
        np.concatenate([upper, slack_limit, free]),
    )
    plain = n * (2 * shape.lines) - shape.lines
    longest = task.step_length_m - STEP_PAD_M if shape.motion is None else np.inf
    rows = Bounds(
        np.concatenate([np.full(n, -np.inf), np.zeros(plain), motion.rows.lower, bound]),
        np.concatenate(
            [
                np.full(n, longest**2),
                np.full(plain, np.inf),
                motion.rows.upper,
                np.full(len(bound), np.inf),
            ]
        ),
    )
    charge = np.zeros(0) if task.charge is None else task.charge.numbers
    nlp.source.use(task.evaluate)
    missing = np.zeros(0) if shape.slacks == 0 else _missing_db(task, bound)
    point = nlp.solve(
        np.concatenate([task.path_m.ravel(), np.minimum(missing, slack_limit), motion.start]),
        np.concatenate([head, line.ravel(), motion.parameters, charge]),
        variables,
        rows,
    )
    driven = point.slack_db[shape.slacks :]
    point = replace(point, slack_db=point.slack_db[: shape.slacks])
    return RefinedPath(
        path_m=point.positions_m,
        slack_db=point.slack_db,
        termination=point.termination,
        iterations=point.iterations,
        kkt_residual=_residual(task, point, line, rows, variables, motion, driven),
        multipliers=named_multipliers(point.row_multipliers, n, shape.lines, len(bound)),
        inputs=None if task.motion is None else task.motion.shape.inputs_of(driven),
    )


def _position_bounds(task: PathTask, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the workspace's bounds (2 N,); after the arrival positions are those of the start."""
    x_min, y_min, x_max, y_max = task.bounds_m
    lower, upper = np.tile([x_min, y_min], n), np.tile([x_max, y_max], n)
    if task.arrival is not None:
        arrived = slice(2 * (task.arrival - 1), 2 * n)
        lower[arrived] = upper[arrived] = task.path_m[task.arrival - 1 :].ravel()
    return lower, upper


def _missing_db(task: PathTask, bound: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slack that the start path needs."""
    at = task.evaluate(task.path_m)
    if at.margins is not None:
        return np.maximum(bound - at.margins.value, 0.0)
    if at.total is None:
        raise AssertionError("a bound on nothing")
    return np.maximum(bound - at.total.value, 0.0) / task.total_per_db


def _residual(
    task: PathTask,
    point: NlpPoint,
    line: NDArray[np.float64],
    row_bounds: Bounds,
    variable_bounds: Bounds,
    motion: MotionNumbers,
    driven: NDArray[np.float64],
) -> float:
    """KKT residual with the rows' gradients written out in NumPy."""
    n, slacks = len(task.path_m), len(point.slack_db)
    if not (np.isfinite(point.positions_m).all() and np.isfinite(point.row_multipliers).all()):
        return float("inf")
    rows, by_place = path_row_values(np.vstack([task.start_m, point.positions_m]), line)
    driven_rows, driven_jacobian = motion.values(point.positions_m, driven)
    rows = np.concatenate([rows, driven_rows])
    jacobian = np.zeros((len(rows), 2 * n + len(driven)))
    jacobian[: len(by_place), : 2 * n] = by_place
    jacobian[len(by_place) :] = driven_jacobian
    at = task.evaluate(point.positions_m)
    if at.margins is not None:
        stage = np.arange(n)
        connectivity = np.zeros((n, jacobian.shape[1]))
        connectivity[stage, 2 * stage] = at.margins.gradient[:, 0]
        connectivity[stage, 2 * stage + 1] = at.margins.gradient[:, 1]
        margins = at.margins.value + point.slack_db if slacks else at.margins.value
        rows = np.concatenate([rows, margins])
        jacobian = np.concatenate([jacobian, connectivity])
    slack_columns = np.zeros((len(jacobian), slacks))
    if at.margins is not None and slacks:
        slack_columns[-slacks:] = np.eye(slacks)
    if at.total is not None:
        rows = np.append(rows, at.total.value + task.total_per_db * point.slack_db)
        total = np.zeros((1, jacobian.shape[1]))
        total[0, : 2 * n] = at.total.gradient.ravel()
        jacobian = np.vstack([jacobian, total])
        slack_columns = np.vstack([slack_columns, [[task.total_per_db]]])
    by_goal = motion.gradient(point.positions_m, driven, task.charge)
    return kkt_residual(
        np.concatenate(
            [
                task.scale * (by_goal[: 2 * n] - at.value.gradient.ravel()),
                np.full(slacks, task.slack_weight),
                task.scale * by_goal[2 * n :],
            ]
        ),
        np.hstack([jacobian[:, : 2 * n], slack_columns, jacobian[:, 2 * n :]]),
        rows,
        row_bounds,
        point.row_multipliers,
        np.concatenate([point.positions_m.ravel(), point.slack_db, driven]),
        variable_bounds,
        point.variable_multipliers,
    )


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
