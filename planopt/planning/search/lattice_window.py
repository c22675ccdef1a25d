"""Windows: the parts of the lattice that are looked at, with a margin of closed nodes around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.world.lattice import MOVES

Window = tuple[slice, slice]
"""Rows and columns of a part of the lattice."""

REACH = max(max(abs(dx), abs(dy)) for dx, dy in MOVES)
"""Nodes that a move leads along either axis at most, and the margin's width."""


def window_around(
    low: NDArray[np.intp], high: NDArray[np.intp], grown: int, shape: tuple[int, int]
) -> Window:
    """The nodes from `low` to `high`, grown to all sides, in the lattice with its margin."""
    rows, columns = (
        slice(
            max(int(low[axis]) - grown, 0) + REACH,
            min(int(high[axis]) + grown, shape[axis] - 1) + REACH + 1,
        )
        for axis in (0, 1)
    )
    return rows, columns


def without_margin(window: Window) -> Window:
    """A window in the lattice without its margin."""
    rows, columns = window
    return (
        slice(rows.start - REACH, rows.stop - REACH),
        slice(columns.start - REACH, columns.stop - REACH),
    )


def window_shape(window: Window) -> tuple[int, int]:
    """Rows and columns of a window, counted."""
    return window[0].stop - window[0].start, window[1].stop - window[1].start
