"""The separating lines of a start path, and those that a refined path turned out to lack."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs, path_distances_m
from planopt.world.separation import (
    PackedPieces,
    SeparatingLines,
    joined_lines,
    lines_for,
    moving_lines,
    separating_lines,
)

LINE_REACH_STEPS = 2.0
"""Pieces farther than this many longest steps from a segment get no line."""

REPAIRS = 3
"""How often a refinement whose proof objects is repeated with the objection built in."""


MOVING_LINES = 3
"""Nearest moving discs that each segment is kept from."""


def moving_count(discs: MovingDiscs) -> int:
    """Lines a segment that are for what moves; they come after those of obstacles."""
    return min(MOVING_LINES, len(discs))


def lines_about(
    pieces: PackedPieces,
    discs: MovingDiscs,
    path_m: NDArray[np.float64],  # (N + 1, 2) the start path, the robot's place first
    count: int,
    clearance_m: float,
    step_length_m: float,
    pad_m: float = 0.0,
) -> SeparatingLines:
    """Lines of a start path from the convex pieces and the moving discs nearest to its segments."""
    reach = LINE_REACH_STEPS * step_length_m
    standing = count - moving_count(discs)
    lines = separating_lines(pieces, path_m[:-1], path_m[1:], standing, reach)
    if not len(discs):
        return lines
    moving = moving_lines(discs, path_m, clearance_m, moving_count(discs), reach, pad_m=pad_m)
    return joined_lines(lines, moving)


def lines_with_violated(
    pieces: PackedPieces,
    lines: SeparatingLines,
    start_path_m: NDArray[np.float64],
    path_m: NDArray[np.float64],
    clearance_m: float,
    step_length_m: float,
    discs: MovingDiscs = NOTHING_MOVES,
    pad_m: float = 0.0,
) -> SeparatingLines | None:
    """Lines of the start path with what the result comes too near to put in.

    None if nothing is to blame that has no line.
    """
    # Shapes: start_path_m, path_m (N + 1, 2).
    standing = lines.piece.shape[1] - moving_count(discs)
    chosen = lines.piece[:, :standing].copy()
    now = separating_lines(pieces, path_m[:-1], path_m[1:], standing, step_length_m)
    changed = False
    limit = clearance_m - CLEARANCE_TOLERANCE_M
    for k, j in zip(*np.nonzero(now.gaps < limit), strict=True):
        violated = now.piece[k, j]
        if violated >= 0 and violated not in chosen[k]:
            chosen[k, -1] = violated
            changed = True
    needed = _discs_met(discs, lines.piece[:, standing:], path_m)
    if not (changed or needed.any()):
        return None
    again = lines_for(pieces, start_path_m[:-1], start_path_m[1:], chosen)
    if not len(discs):
        return again
    reach = LINE_REACH_STEPS * step_length_m
    return joined_lines(
        again,
        moving_lines(discs, start_path_m, clearance_m, moving_count(discs), reach, needed, pad_m),
    )


def tail_count(discs: MovingDiscs, horizon: int) -> int:
    """Lines of the last segment, and of stopping, that are for what moves after the plan."""
    return moving_count(discs) if discs.steps > horizon else 0


def _discs_met(
    discs: MovingDiscs, chosen: NDArray[np.int64], path_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which discs a path comes too near to in steps that have no line from them; (m, N)."""
    if not len(discs):
        return np.zeros((0, len(path_m) - 1), dtype=np.bool_)
    apart = discs.apart_m[:, : len(path_m) - 1]
    near = path_distances_m(discs, path_m) < apart - CLEARANCE_TOLERANCE_M
    numbers = np.arange(len(discs))[:, None, None]
    return near & ~(chosen == numbers).any(axis=2)
