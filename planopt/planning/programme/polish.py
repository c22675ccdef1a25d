"""Polish a start path with IPOPT: same homotopy class, continuous places, exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from planopt.planning.plan import Termination
from planopt.planning.programme.cone_rows import path_row_values
from planopt.planning.programme.margin_source import MarginFunction, StageMargins
from planopt.planning.programme.nlp_functions import (
    Bounds,
    NlpPoint,
    kkt_residual,
    named_multipliers,
)
from planopt.planning.programme.path_nlp import PIVOT_ROUNDING_M, STEP_ROUNDING_M, ReachNlp
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.world.separation import SeparatingLines


@dataclass(frozen=True)
class Polished:
    """The result of a polish."""

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
class OutagePrice:
    """The price of being out of contact on the way."""

    price_s_m: float  # Of a metre that is certainly out of contact
    share_before: float  # Share of a metre that is charged at the start
    # (N,) the same after each step, were that certainly out of contact
    charged: NDArray[np.float64]


@dataclass(frozen=True)
class ReachTask:
    """The task of one polish."""

    start_m: NDArray[np.float64]  # (2,) where the robot is
    path_m: NDArray[np.float64]  # (N, 2) the start path
    lines: SeparatingLines  # Separating lines of the start path's N segments
    clearance_m: float  # Limits
    step_length_m: float
    bounds_m: tuple[float, float, float, float]  # The workspace (x_min, y_min, x_max, y_max)
    # Step (1..N) from which on the start path stands still and so does the polished one; None if it
    # moves to its end
    arrival: int | None
    # (2,) the visible point on the way to the goal that the last position is drawn to
    pivot_m: NDArray[np.float64]
    effort_s_m2: float  # Cost of squared step length, and of a metre beyond the horizon
    rate_s_m: float
    # Connectivity margin of each stage by position, then the score of each that the probability of
    # connection has
    margins: MarginFunction
    bound_db: NDArray[np.float64]  # (N,) what the margins must reach
    outage: OutagePrice  # What it costs to be out of contact after each step


def polish(nlp: ReachNlp, task: ReachTask) -> Polished:
    """Solve the programme from the task's start path."""
    n = nlp.horizon
    outage = task.outage
    head = np.array(
        [
            *task.start_m,
            *task.pivot_m,
            task.effort_s_m2,
            task.rate_s_m,
            outage.price_s_m,
            outage.share_before,
        ]
    )
    line = task.lines.rows(task.clearance_m + CLEARANCE_PAD_M)
    variables = _position_bounds(task, n)
    plain = n * (2 * nlp.lines) - nlp.lines
    longest = task.step_length_m - STEP_PAD_M
    rows = Bounds(
        np.concatenate([np.full(n, -np.inf), np.zeros(plain), task.bound_db]),
        np.concatenate([np.full(n, longest**2), np.full(plain + n, np.inf)]),
    )
    nlp.source.use(task.margins)
    point = nlp.solve(
        task.path_m.ravel(),
        np.concatenate([head, outage.charged, line.ravel()]),
        variables,
        rows,
    )
    residual = _residual(nlp, task, point, line, rows, variables)
    return Polished(
        path_m=point.positions_m,
        slack_db=point.slack_db,
        termination=point.termination,
        iterations=point.iterations,
        kkt_residual=residual,
        multipliers=named_multipliers(point.row_multipliers, n, nlp.lines, n),
    )


def _position_bounds(task: ReachTask, n: int) -> Bounds:
    """Workspace bounds; from the arrival on the positions are fixed at the start path's end."""
    x_min, y_min, x_max, y_max = task.bounds_m
    lower, upper = np.tile([x_min, y_min], n), np.tile([x_max, y_max], n)
    if task.arrival is not None:
        standing = slice(2 * (task.arrival - 1), 2 * n)
        lower[standing] = upper[standing] = task.path_m[task.arrival - 1 :].ravel()
    return Bounds(lower, upper)


def _residual(
    nlp: ReachNlp,
    task: ReachTask,
    point: NlpPoint,
    line: NDArray[np.float64],
    row_bounds: Bounds,
    variable_bounds: Bounds,
) -> float:
    """KKT residual with gradients written out in NumPy."""
    n = nlp.horizon
    if not (np.isfinite(point.positions_m).all() and np.isfinite(point.row_multipliers).all()):
        return float("inf")
    q = np.vstack([task.start_m, point.positions_m])
    margins = task.margins(point.positions_m)
    gradient = _gradient(task, q, margins)
    plain, plain_jacobian = path_row_values(q, line)
    stage = np.arange(n)
    connectivity = np.zeros((n, n, 2))
    connectivity[stage, stage] = margins.gradient[:n]
    jacobian = np.concatenate([plain_jacobian, connectivity.reshape(n, 2 * n)])
    return kkt_residual(
        gradient.ravel(),
        jacobian,
        np.concatenate([plain, margins.value[:n]]),
        row_bounds,
        point.row_multipliers,
        point.positions_m.ravel(),
        variable_bounds,
        point.variable_multipliers,
    )


def _gradient(
    task: ReachTask, q: NDArray[np.float64], margins: StageMargins
) -> NDArray[np.float64]:
    """Gradient (N, 2) of the cost of places (N + 1, 2), the start first."""
    outage = task.outage
    steps = np.diff(q, axis=0)
    lengths = np.sqrt((steps**2).sum(axis=1) + STEP_ROUNDING_M**2)
    score = margins.value[len(steps) :]
    share = np.append(outage.share_before, outage.charged * ndtr(-score))
    density = np.exp(-0.5 * score**2) / np.sqrt(2.0 * np.pi)
    slope = -outage.charged * density
    by_length = outage.price_s_m * 0.5 * (share[:-1] + share[1:])
    by_step = (2.0 * task.effort_s_m2 + (by_length / lengths)[:, None]) * steps
    by_share = outage.price_s_m * 0.5 * (lengths + np.append(lengths[1:], 0.0))
    gradient = by_step + (by_share * slope)[:, None] * margins.gradient[len(steps) :]
    gradient[:-1] -= by_step[1:]
    to_pivot = q[-1] - task.pivot_m
    gradient[-1] += task.rate_s_m * to_pivot / np.sqrt(to_pivot @ to_pivot + PIVOT_ROUNDING_M**2)
    return gradient
