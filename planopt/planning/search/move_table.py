"""The moves of a lattice and its windows, tabulated for searching stage by stage.

A window is the part of the lattice that is looked at, with a margin of closed nodes around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.world.lattice import MOVES, Lattice


@dataclass(frozen=True)
class MoveTable:
    """The moves of a lattice, ready for searching.

    Attributes
    ----------
    lattice
        Whose moves they are.
    closed
        ``(21, ny + 2 REACH, nx + 2 REACH)``: 0 where a move from the node is open, else minus
        infinity; with a margin of closed nodes around the lattice.
    hindered
        ``(ny, nx)`` free nodes that some move from a free node does not lead to.
    """

    lattice: Lattice
    closed: NDArray[np.float64]
    hindered: NDArray[np.bool_]


def move_table(lattice: Lattice) -> MoveTable:
    """Tabulate the moves of a lattice."""
    inside = np.where(lattice.open_moves, 0.0, -np.inf)
    margin = ((0, 0), (REACH, REACH), (REACH, REACH))
    closed = np.pad(inside, margin, constant_values=-np.inf)
    free = np.pad(lattice.free, REACH)
    ny, nx = lattice.shape
    hindered = np.zeros(lattice.shape, dtype=np.bool_)
    for move, (dx, dy) in enumerate(MOVES):
        source = (
            slice(REACH - dy, REACH - dy + ny),
            slice(REACH - dx, REACH - dx + nx),
        )
        hindered |= free[source] & (closed[move][source] != 0.0)
    return MoveTable(lattice, closed, hindered & lattice.free)


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
