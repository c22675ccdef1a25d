"""Polish a start path with IPOPT: same homotopy class, continuous places, exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.programme.kkt import Bounds, kkt_residual
from planopt.planning.programme.margin_source import MarginFunction
from planopt.planning.programme.named_multipliers import named_multipliers
from planopt.planning.programme.nlp_point import NlpPoint
from planopt.planning.programme.path_row_values import path_row_values
from planopt.planning.programme.polished import Polished
from planopt.planning.programme.reach_nlp import PIVOT_ROUNDING_M, ReachNlp
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.world.separation import SeparatingLines


@dataclass(frozen=True)
class ReachTask:
    """What one polish is to do.

    Attributes
    ----------
    start_m
        ``(2,)`` where the robot is.
    path_m
        ``(N, 2)`` the start path.
    lines
        Separating lines of the start path's N segments.
    clearance_m, step_length_m
        Limits.
    bounds_m
        The workspace ``(x_min, y_min, x_max, y_max)``.
    arrival
        Step (1..N) from which on the start path stands still and so does the polished one; None
        if it moves to its end.
    pivot_m
        ``(2,)`` the visible point on the way to the goal that the last position is drawn to.
    effort_s_m2, rate_s_m
        Cost of squared step length, and of a metre beyond the horizon.
    margins
        Connectivity margin of each stage by position.
    bound_db
        ``(N,)`` what the margins must reach.
    slack_limit_db
        ``(N,)`` how much of it may be missing; zero where the bound is hard.
    slack_price_s_db
        What a missing dB costs.
    """

    start_m: NDArray[np.float64]
    path_m: NDArray[np.float64]
    lines: SeparatingLines
    clearance_m: float
    step_length_m: float
    bounds_m: tuple[float, float, float, float]
    arrival: int | None
    pivot_m: NDArray[np.float64]
    effort_s_m2: float
    rate_s_m: float
    margins: MarginFunction
    bound_db: NDArray[np.float64]
    slack_limit_db: NDArray[np.float64]
    slack_price_s_db: float = 0.0


def polish(nlp: ReachNlp, task: ReachTask) -> Polished:
    """Solve the programme from the task's start path."""
    n = nlp.horizon
    head = np.array(
        [*task.start_m, *task.pivot_m, task.effort_s_m2, task.rate_s_m, task.slack_price_s_db]
    )
    line = task.lines.rows(task.clearance_m + CLEARANCE_PAD_M)
    positions = _position_bounds(task, n)
    variables = Bounds(
        np.concatenate([positions.lower, np.zeros(n)]),
        np.concatenate([positions.upper, task.slack_limit_db]),
    )
    plain = n * (2 * nlp.lines) - nlp.lines
    longest = task.step_length_m - STEP_PAD_M
    rows = Bounds(
        np.concatenate([np.full(n, -np.inf), np.zeros(plain), task.bound_db]),
        np.concatenate([np.full(n, longest**2), np.full(plain + n, np.inf)]),
    )
    nlp.source.use(task.margins)
    missing = np.maximum(task.bound_db - task.margins(task.path_m).value, 0.0)
    start = np.concatenate([task.path_m.ravel(), np.minimum(missing, task.slack_limit_db)])
    point = nlp.solve(
        start,
        np.concatenate([head, line.ravel()]),
        variables,
        rows,
    )
    residual = _residual(nlp, task, point, head, line, rows, variables)
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
    head: NDArray[np.float64],
    line: NDArray[np.float64],
    row_bounds: Bounds,
    variable_bounds: Bounds,
) -> float:
    """KKT residual with gradients written out in NumPy."""
    n = nlp.horizon
    if not (np.isfinite(point.positions_m).all() and np.isfinite(point.row_multipliers).all()):
        return float("inf")
    q = np.vstack([task.start_m, point.positions_m])
    steps = np.diff(q, axis=0)
    effort, rate, slack_price = head[4:]
    gradient = np.zeros((n, 2))
    gradient += 2.0 * effort * steps
    gradient[:-1] -= 2.0 * effort * steps[1:]
    to_pivot = q[-1] - task.pivot_m
    gradient[-1] += rate * to_pivot / np.sqrt(to_pivot @ to_pivot + PIVOT_ROUNDING_M**2)

    margins = task.margins(point.positions_m)
    plain, plain_jacobian = path_row_values(q, line)
    stage = np.arange(n)
    connectivity = np.zeros((n, n, 2))
    connectivity[stage, stage] = margins.gradient
    jacobian = np.concatenate([plain_jacobian, connectivity.reshape(n, 2 * n)])
    slack_columns = np.zeros((len(jacobian), n))
    slack_columns[-n:] = np.eye(n)
    rows = np.concatenate([plain, margins.value + point.slack_db])
    return kkt_residual(
        np.concatenate([gradient.ravel(), np.full(n, slack_price)]),
        np.hstack([jacobian, slack_columns]),
        rows,
        row_bounds,
        point.row_multipliers,
        np.concatenate([point.positions_m.ravel(), point.slack_db]),
        variable_bounds,
        point.variable_multipliers,
    )
