"""The moves of a lattice, tabulated for searching stage by stage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.search.lattice_window import REACH
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
