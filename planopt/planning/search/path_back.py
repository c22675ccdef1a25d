"""Tracing the best path to a node back through the values of a lattice search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.search.lattice_window import REACH
from planopt.planning.search.reward_lattice import LatticeValues
from planopt.world.lattice import MOVES

MOVES_BY_NUMBER = tuple((int(dx), int(dy)) for dx, dy in MOVES)
"""(dx, dy) of each move."""


def path_to(found: LatticeValues, end: tuple[int, int]) -> NDArray[np.intp]:
    """Nodes (N, 2) as (iy, ix) of the best path that ends at `end`."""
    nodes = [end]
    for stage in range(len(found.values) - 2, -1, -1):
        blocked = None
        if found.moving is not None:
            row, column = np.array(nodes[-1]).reshape(2, 1)
            blocked = found.moving.blocked(stage + 1, row, column)[:, 0]
        nodes.append(_best_source(found, stage, nodes[-1], blocked))
    return np.array(nodes[::-1], dtype=np.intp)


def _best_source(
    found: LatticeValues, stage: int, node: tuple[int, int], blocked: NDArray[np.bool_] | None
) -> tuple[int, int]:
    """Which of the 21 nodes (iy, ix) its best value came from, by a move not `blocked`."""
    # One by one: for so few, arrays cost several times as much.
    (rows, columns), value, closed = found.windows[stage], found.values[stage], found.table.closed
    height, width = value.shape
    best, source = -np.inf, node
    for move, (dx, dy) in enumerate(MOVES_BY_NUMBER):
        if blocked is not None and blocked[move]:
            continue
        row, column = node[0] - dy + REACH, node[1] - dx + REACH
        inside_row, inside_column = row - rows.start, column - columns.start
        if 0 <= inside_row < height and 0 <= inside_column < width:
            arriving = value.item(inside_row, inside_column) + closed.item(move, row, column)
            arriving += found.move_value.item(move)
            if arriving > best:
                best, source = arriving, (row - REACH, column - REACH)
    return source
