"""Refinement of an initial guess for any smooth objective: separating lines, data and solve."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats, Mask
from planopt.planning.plan import Termination
from planopt.planning.programme.goal_value import EvaluatePath, GoalCharge
from planopt.planning.programme.path_nlp import PathNlp
from planopt.planning.programme.solver import (
    Bounds,
    MotionShape,
    NlpPoint,
    PathShape,
    kkt_residual,
    motion_rows,
)
from planopt.planning.tolerances import CLEARANCE_PAD_M, CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive
from planopt.world.moving_discs import MovingDiscs, path_distances_m
from planopt.world.separation import (
    PackedPieces,
    SeparatingLines,
    joined_lines,
    lines_for,
    moving_lines,
    separating_lines,
)


@dataclass(frozen=True, eq=False)
class MotionTask:
    """Initial guess of a robot with dynamics, and separating lines for its braking path."""

    shape: MotionShape
    drive: Drive  # Drive along the guess, from the robot's state
    stop_lines: SeparatingLines  # Separating lines of the subsequent braking segment


@dataclass(frozen=True)
class RefinedPath:
    """Path that a solver returned, with multipliers and status, not yet verified."""

    path_m: Floats  # (N, 2)
    slack_db: Floats  # (N,) shortfall in dB
    termination: Termination
    iterations: int
    kkt_residual: float  # KKT residual of the unscaled programme
    # By row: speed (N,), line_end (N, lines), line_start (N - 1, lines), connectivity (N,)
    multipliers: dict[str, Floats]
    inputs: Floats | None = None  # (N, m) inputs of a robot with dynamics


@dataclass(frozen=True)
class PathTask:
    """Optimisation problem that refines one initial guess."""

    start_m: Floats  # (2,) the robot's position
    path_m: Floats  # (N, 2) the guess
    lines: SeparatingLines  # Separating lines of the guess's N segments
    clearance_m: float
    step_length_m: float
    bounds_m: tuple[float, float, float, float]  # The workspace (x_min, y_min, x_max, y_max)
    evaluate: EvaluatePath  # Maps a path to its value and margins
    scale: float  # Factor of the value, as solver tolerances are absolute
    # (N,) lower bounds of the margins in dB, or (1,) of their sum; None without connectivity rows
    bound: Floats | None = None
    per_db: float = 1.0  # Change of a row per dB of slack
    slack_limit_db: Floats | None = None  # Upper bounds of the slack; 0 if hard
    slack_weight: float = 0.0  # Cost per dB of slack
    motion: MotionTask | None = None  # None for the single integrator
    charge: GoalCharge | None = None  # Goal cost; None without a goal
    # Step (1..N) from which guess and refined path stay at their end, if any
    arrival: int | None = None


def polish_path(nlp: PathNlp, task: PathTask) -> RefinedPath:
    """Return the solution of the programme from the task's guess."""
    shape, motion = nlp.shape, task.motion
    n, lines = shape.horizon, shape.lines
    bound = np.zeros(0) if task.bound is None else task.bound
    slack_limit = np.zeros(shape.slacks) if task.slack_limit_db is None else task.slack_limit_db
    pad = 0.0 if shape.motion is None else shape.motion.dynamics.hull_pad_m(shape.motion.step_s)
    kept = task.clearance_m + pad + CLEARANCE_PAD_M
    line = task.lines.rows(kept).ravel()
    longest = task.step_length_m - STEP_PAD_M if shape.motion is None else np.inf
    driven, own = np.zeros(0), np.zeros(0)
    motion_bounds = np.zeros(0), np.zeros(0)
    if motion is not None:
        driven = np.hstack([motion.drive.states[1:, 2:], motion.drive.inputs]).ravel()
        stop, states = motion.stop_lines.rows(kept).ravel(), motion.drive.states
        own = np.concatenate([states[0, 2:], stop])
        every = np.concatenate([line, stop])
        rows = motion_rows(motion.shape, states[1:, :2].ravel(), driven, tuple(states[0]), every)
        motion_bounds = rows.bounds(task.bounds_m)
    x_min, y_min, x_max, y_max = task.bounds_m
    lower, upper = np.tile([x_min, y_min], n), np.tile([x_max, y_max], n)
    if task.arrival is not None:
        arrived = slice(2 * (task.arrival - 1), 2 * n)
        lower[arrived] = upper[arrived] = task.path_m[task.arrival - 1 :].ravel()
    free = np.full(len(driven), np.inf)
    variables = Bounds(
        np.concatenate([lower, np.zeros(shape.slacks), -free]),
        np.concatenate([upper, slack_limit, free]),
    )
    apart, none = np.zeros(n * 2 * lines - lines), np.full(n, np.inf)
    row_bounds = Bounds(
        np.concatenate([-none, apart, motion_bounds[0], bound]),
        np.concatenate(
            [np.full(n, longest**2), apart + np.inf, motion_bounds[1], np.full(len(bound), np.inf)]
        ),
    )
    head = np.array([*task.start_m, task.scale, task.slack_weight, task.per_db])
    charge = np.zeros(0) if task.charge is None else task.charge.numbers
    parameters = np.concatenate([head, line, own, charge])
    nlp.source.use(task.evaluate)
    missing = np.zeros(0)
    if shape.slacks:
        missing = np.maximum(bound - task.evaluate(task.path_m).rows, 0.0) / task.per_db
    guess = np.concatenate([task.path_m.ravel(), np.minimum(missing, slack_limit), driven])
    point = nlp.solve(guess, parameters, variables, row_bounds)
    slack, driven = np.split(point.others, [shape.slacks])
    inputs = None
    if motion is not None:
        inputs = driven.reshape(n, motion.shape.per_step)[:, motion.shape.rest :]
    return RefinedPath(
        path_m=point.positions_m,
        slack_db=slack,
        termination=point.termination,
        iterations=point.iterations,
        kkt_residual=_residual(nlp, point, parameters, variables, row_bounds),
        multipliers=_named_multipliers(point.row_multipliers, shape),
        inputs=inputs,
    )


def _residual(
    nlp: PathNlp, point: NlpPoint, parameters: Floats, variable_bounds: Bounds, row_bounds: Bounds
) -> float:
    """Return the KKT residual at a solver's point; infinite if it is not finite."""
    at = np.concatenate([point.positions_m.ravel(), point.others])
    if not (np.isfinite(at).all() and np.isfinite(point.row_multipliers).all()):
        return float("inf")
    nlp.source(point.positions_m)  # CasADi would hide exceptions of user-defined terms.
    gradient, jacobian = nlp.functions.slopes(at, parameters)
    return kkt_residual(
        gradient,
        jacobian,
        nlp.functions.values(at, parameters)[1],
        row_bounds,
        point.row_multipliers,
        at,
        variable_bounds,
        point.variable_multipliers,
    )


def _named_multipliers(rows: Floats, shape: PathShape) -> dict[str, Floats]:
    """Return the multipliers of the geometric and connectivity rows by name."""
    n, lines = shape.horizon, shape.lines
    speed, line_end, line_start = np.split(
        rows[: n * (1 + 2 * lines) - lines], [n, n * (1 + lines)]
    )
    found = {
        "speed": speed,
        "line_end": line_end.reshape(n, lines),
        "line_start": line_start.reshape(n - 1, lines),
    }
    return found | ({"connectivity": rows[len(rows) - shape.bounds :]} if shape.bounds else {})


LINE_REACH_STEPS = 2.0
"""Distance, in longest steps, beyond which a convex piece gets no line for a segment."""
REPAIRS = 3
"""Maximum number of refinements of a guess; each adds lines for the violations found before."""
MOVING_LINES = 3
"""Maximum number of moving discs, nearest first, with a separating line for a segment."""


def moving_count(discs: MovingDiscs) -> int:
    """Return the number of separating lines that each segment reserves for moving discs."""
    return min(MOVING_LINES, len(discs))


def lines_about(
    problem: Problem, pieces: PackedPieces, discs: MovingDiscs, path_m: Floats, count: int
) -> SeparatingLines:
    """Return `count` separating lines per segment, for nearby obstacle pieces and moving discs."""
    # Shapes: path_m (N + 1, 2), the robot's position, then the guess.
    reach = LINE_REACH_STEPS * problem.step_length_m
    standing = count - moving_count(discs)
    lines = separating_lines(pieces, path_m[:-1], path_m[1:], standing, reach)
    return joined_lines(lines, _moving_lines(problem, discs, path_m)) if len(discs) else lines


def lines_with_violated(
    problem: Problem,
    pieces: PackedPieces,
    discs: MovingDiscs,
    task: PathTask,
    found_m: Floats,  # (N, 2)
    lines: SeparatingLines,
) -> SeparatingLines | None:
    """Return `lines` with new lines for obstacles that a path hits; None if it hits none."""
    guess_m, path_m = (np.vstack([task.start_m, each]) for each in (task.path_m, found_m))
    standing = lines.piece.shape[1] - moving_count(discs)
    chosen = lines.piece[:, :standing].copy()
    now = separating_lines(pieces, path_m[:-1], path_m[1:], standing, problem.step_length_m)
    changed = False
    limit = problem.constraints.clearance_m - CLEARANCE_TOLERANCE_M
    for k, j in zip(*np.nonzero(now.gaps < limit), strict=True):
        violated = now.piece[k, j]
        if violated >= 0 and violated not in chosen[k]:
            chosen[k, -1] = violated
            changed = True
    needed = _discs_met(discs, lines.piece[:, standing:], path_m)
    if not (changed or needed.any()):
        return None
    again = lines_for(pieces, guess_m[:-1], guess_m[1:], chosen)
    if not len(discs):
        return again
    return joined_lines(again, _moving_lines(problem, discs, guess_m, needed))


def _moving_lines(
    problem: Problem, discs: MovingDiscs, path_m: Floats, needed: Mask | None = None
) -> SeparatingLines:
    """Return separating lines for the nearest moving discs and for all discs in `needed`."""
    reach = LINE_REACH_STEPS * problem.step_length_m
    # The pad covers the robot's uncertain position within a step.
    pad_m = problem.robots[0].dynamics.timed_pad_m(problem.planner.step_s)
    clearance, count = problem.constraints.clearance_m, moving_count(discs)
    return moving_lines(discs, path_m, clearance, count, reach, needed, pad_m)


def _discs_met(discs: MovingDiscs, chosen: NDArray[np.int64], path_m: Floats) -> Mask:
    """Return a mask (m, N) of the discs and steps where a path collides without a line."""
    if not len(discs):
        return np.zeros((0, len(path_m) - 1), dtype=np.bool_)
    apart = discs.apart_m[:, : len(path_m) - 1]
    near = path_distances_m(discs, path_m) < apart - CLEARANCE_TOLERANCE_M
    numbers = np.arange(len(discs))[:, None, None]
    return near & ~(chosen == numbers).any(axis=2)
