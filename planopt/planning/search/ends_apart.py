"""Where the best paths of a lattice search end, apart from each other."""

from __future__ import annotations

import numpy as np

from planopt.planning.search.lattice_window import REACH
from planopt.planning.search.reward_lattice import LatticeValues


def best_ends(found: LatticeValues, count: int, apart: int) -> list[tuple[int, int]]:
    """The nodes (iy, ix) of the highest values after the last step, best first.

    Parameters
    ----------
    found
        What the search found.
    count
        How many, fewer if there are no more.
    apart
        Nodes along either axis that each is more than away from every better one.
    """
    left = found.values[-1].copy()
    top, beside = (part.start - REACH for part in found.windows[-1])
    ends: list[tuple[int, int]] = []
    while len(ends) < count:
        row, column = (int(i) for i in np.unravel_index(int(np.argmax(left)), left.shape))
        if not np.isfinite(left[row, column]):
            break
        ends.append((row + top, column + beside))
        left[
            max(row - apart, 0) : row + apart + 1, max(column - apart, 0) : column + apart + 1
        ] = -np.inf
    return ends
