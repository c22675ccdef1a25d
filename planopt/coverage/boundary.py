"""Boundaries of cells as straight pieces and arcs about the agent, cut at the sensing range.

Integrals over a cell become sums over the pieces of its boundary: over the triangle or sector
between the agent and the piece, or along the piece (Green's theorem).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.region import ConvexRegion, positive
from planopt.coverage.voronoi import Cells


@dataclass(frozen=True, eq=False)
class Boundary:
    """Closed boundaries of cells, counter-clockwise, each as seen from its centre.

    A cell contains the whole straight line from its centre to any place of it.
    """

    centres_m: NDArray[np.float64]  # (g, 2) the agent's place for each cell
    cell: NDArray[np.intp]  # (e,) number of the cell of each piece
    start_m: NDArray[np.float64]  # (e, 2) both ends of each piece, relative to the cell's centre
    end_m: NDArray[np.float64]
    # (e,) angle between both ends in rad where the piece is an arc about the centre; 0 where it is
    # straight
    angle: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Moments:
    """Integrals of a density over cells, taken about the cells' centres."""

    mass: NDArray[np.float64]  # (g,) integral of the density
    first: NDArray[np.float64]  # (g, 2) integral of the density times the offset from the centre
    # (g,) integral of the density times the squared distance from the centre
    second: NDArray[np.float64]


def cell_boundary(cells: Cells, sensing_range_m: float | None = None) -> Boundary:
    """Return the boundaries of all cells, of the part within the sensing range if there is one."""
    cell = cells.inside.polygon_of
    start = cells.inside.corners_m - cells.generators_m[cell]
    end = start[cells.inside.following]
    if sensing_range_m is None:
        return Boundary(cells.generators_m, cell, start, end, np.zeros(len(cell)))
    range_m = positive(sensing_range_m, "sensing_range_m")
    return _within_range(cells.generators_m, cell, start, end, range_m)


def region_boundary(region: ConvexRegion) -> Boundary:
    """Return the boundary of a whole region as that of a single cell about its middle."""
    middle = region.corners_m.mean(axis=0)
    start = region.corners_m - middle
    sides = len(start)
    none = np.zeros(sides)
    return Boundary(
        middle[None], np.zeros(sides, dtype=np.intp), start, np.roll(start, -1, axis=0), none
    )


def _within_range(
    centres_m: NDArray[np.float64],
    cell: NDArray[np.intp],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    range_m: float,
) -> Boundary:
    """Replace what is beyond the range by arcs; arguments and result as in :class:`Boundary`."""
    along = end - start
    square = (along * along).sum(axis=1)
    middle = (start * along).sum(axis=1)
    past = (start * start).sum(axis=1) - range_m**2
    root2 = middle * middle - square * past
    meets = (root2 > 0.0) & (square > 0.0)
    root = np.sqrt(np.where(meets, root2, 0.0))
    divisor = np.where(square > 0.0, square, 1.0)
    # The part of the edge that is within the range, as shares of it.
    enter = np.clip((-middle - root) / divisor, 0.0, 1.0)
    leave = np.clip((-middle + root) / divisor, 0.0, 1.0)
    inner = meets & (leave > enter)
    first, last = start + enter[:, None] * along, start + leave[:, None] * along
    # An edge that is beyond the range all along becomes one arc.
    before, after = (enter > 0.0) | ~inner, inner & (leave < 1.0)
    tail = np.where(inner[:, None], first, end)
    arcs = [_arc(start[before], tail[before], range_m), _arc(last[after], end[after], range_m)]
    return Boundary(
        centres_m,
        np.concatenate((cell[inner], cell[before], cell[after])),
        np.concatenate((first[inner], arcs[0][0], arcs[1][0])),
        np.concatenate((last[inner], arcs[0][1], arcs[1][1])),
        np.concatenate((np.zeros(int(inner.sum())), arcs[0][2], arcs[1][2])),
    )


def _arc(
    start: NDArray[np.float64], end: NDArray[np.float64], range_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Project both ends (e, 2) of pieces beyond the range to its circle; ends and angles."""
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    angle = np.arctan2(cross, (start * end).sum(axis=1))
    length = np.hypot(start[:, 0], start[:, 1]), np.hypot(end[:, 0], end[:, 1])
    return start * (range_m / length[0])[:, None], end * (range_m / length[1])[:, None], angle
