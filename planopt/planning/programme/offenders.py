"""Put the obstacles that a polished path came too near to into its separating lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.world.separation import PackedPieces, SeparatingLines, lines_for, separating_lines

LINE_REACH_STEPS = 2.0
"""Pieces farther than this many longest steps from a segment get no line."""

REPAIRS = 3
"""How often a polish whose proof objects is repeated with the objection built in."""


def lines_with_offenders(
    pieces: PackedPieces,
    lines: SeparatingLines,
    start_path_m: NDArray[np.float64],
    path_m: NDArray[np.float64],
    clearance_m: float,
    step_length_m: float,
) -> SeparatingLines | None:
    """Lines of the start path with the pieces that the result comes too near to put in.

    None if no piece is to blame.

    Parameters
    ----------
    pieces
        All convex pieces.
    lines
        What the result was kept from.
    start_path_m, path_m
        ``(N + 1, 2)`` the path that the lines are of, and the result, the robot's place first.
    clearance_m, step_length_m
        Limits.
    """
    count = lines.piece.shape[1]
    now = separating_lines(pieces, path_m[:-1], path_m[1:], count, step_length_m)
    chosen = lines.piece.copy()
    changed = False
    limit = clearance_m - CLEARANCE_TOLERANCE_M
    for k, j in zip(*np.nonzero(now.gaps < limit), strict=True):
        offender = now.piece[k, j]
        if offender >= 0 and offender not in chosen[k]:
            chosen[k, -1] = offender
            changed = True
    if not changed:
        return None
    return lines_for(pieces, start_path_m[:-1], start_path_m[1:], chosen)
