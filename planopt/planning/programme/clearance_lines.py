"""Separating lines of an initial guess, and additional lines for violations of a refined path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.problems.problem import Problem
from planopt.world.moving_discs import MovingDiscs, path_distances_m
from planopt.world.separation import (
    PackedPieces,
    SeparatingLines,
    joined_lines,
    lines_for,
    moving_lines,
    separating_lines,
)

LINE_REACH_STEPS = 2.0
"""Convex pieces farther than this many longest steps from a segment get no line."""

REPAIRS = 3
"""Maximum number of refinements of a guess, each with lines for the verified violations added."""

MOVING_LINES = 3
"""Maximum number of moving discs, nearest first, that a segment is separated from."""


def moving_count(discs: MovingDiscs) -> int:
    """Return the number of lines per segment for moving discs; they follow those of obstacles."""
    return min(MOVING_LINES, len(discs))


def tail_count(discs: MovingDiscs, horizon: int) -> int:
    """Return the number of lines of the last segment for discs that move after the plan."""
    return moving_count(discs) if discs.steps > horizon else 0


def lines_about(
    problem: Problem,
    pieces: PackedPieces,
    discs: MovingDiscs,
    path_m: NDArray[np.float64],  # (N + 1, 2) the robot's position, then the guess
    count: int,
) -> SeparatingLines:
    """Return `count` lines per segment from the nearest convex pieces and moving discs."""
    reach = LINE_REACH_STEPS * problem.step_length_m
    standing = count - moving_count(discs)
    lines = separating_lines(pieces, path_m[:-1], path_m[1:], standing, reach)
    return joined_lines(lines, _moving_lines(problem, discs, path_m)) if len(discs) else lines


def lines_with_violated(
    problem: Problem,
    pieces: PackedPieces,
    discs: MovingDiscs,
    lines: SeparatingLines,
    guess_m: NDArray[np.float64],
    path_m: NDArray[np.float64],
) -> SeparatingLines | None:
    """Return the guess's lines plus those that a path violates; None if it violates no others."""
    # Shapes: guess_m, path_m (N + 1, 2).
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
    problem: Problem,
    discs: MovingDiscs,
    path_m: NDArray[np.float64],
    needed: NDArray[np.bool_] | None = None,
) -> SeparatingLines:
    """Return a path's separating lines from the nearest moving discs and from required ones."""
    reach = LINE_REACH_STEPS * problem.step_length_m
    # The pad covers the robot's uncertain position within a step.
    pad_m = problem.robots[0].dynamics.timed_pad_m(problem.planner.step_s)
    clearance, count = problem.constraints.clearance_m, moving_count(discs)
    return moving_lines(discs, path_m, clearance, count, reach, needed, pad_m)


def _discs_met(
    discs: MovingDiscs, chosen: NDArray[np.int64], path_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the discs that a path approaches too closely in steps without their line; (m, N)."""
    if not len(discs):
        return np.zeros((0, len(path_m) - 1), dtype=np.bool_)
    apart = discs.apart_m[:, : len(path_m) - 1]
    near = path_distances_m(discs, path_m) < apart - CLEARANCE_TOLERANCE_M
    numbers = np.arange(len(discs))[:, None, None]
    return near & ~(chosen == numbers).any(axis=2)
