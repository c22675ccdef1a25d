"""The lattice of the global search: which nodes are free and which moves between them are.

Spacing is step / sqrt(5), so that the longest of the 21 moves, a knight's, is one full step.
Nodes and moves keep the clearance by the same exact distances that the
verifier measures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.world.clearance import ObstacleIndex, index_obstacles, is_clear, segment_lines
from planopt.world.lattice_moves import MOVES, blocked_ways, near_pairs, open_moves
from planopt.world.lattice_size import LONGEST_MOVE
from planopt.world.workspace import Workspace

__all__ = [
    "MOVES",
    "Lattice",
    "build_lattice",
    "moves_from",
    "nearest_node",
    "node_positions",
]

MAX_NODES = 10_000_000
"""The 21 moves of this many nodes take 210 MB; more is a mistake in the step or the bounds."""

REACH_TOLERANCE_M = 1e-9
"""A node at exactly the reach stays within it after rounding."""


@dataclass(frozen=True)
class Lattice:
    """A square lattice over the workspace.

    Attributes
    ----------
    origin_m
        ``(2,)`` position of node ``[0, 0]``.
    spacing_m
        Distance of neighbours.
    shape
        ``(ny, nx)``.
    free
        ``(ny, nx)`` whether the node keeps the clearance.
    open_moves
        ``(21, ny, nx)`` whether the way from the node along ``MOVES[k]`` ends on a node and keeps
        the clearance.
    """

    origin_m: NDArray[np.float64]
    spacing_m: float
    shape: tuple[int, int]
    free: NDArray[np.bool_]
    open_moves: NDArray[np.bool_]


def build_lattice(
    workspace: Workspace, anchor_m: NDArray[np.float64], step_m: float, clearance_m: float
) -> Lattice:
    """Lay the lattice through `anchor_m` (2,) over the inside of the bounds.

    Parameters
    ----------
    workspace
        Bounds and obstacles. Nodes on the border of the bounds are left out.
    anchor_m
        A place that nodes are counted from; a node itself if it is within the bounds.
    step_m
        Longest way of one step, over 0.
    clearance_m
        Least distance from every obstacle.

    Raises
    ------
    InputError
        There is no node within the bounds, or there are more than `MAX_NODES`.
    """
    spacing = step_m / LONGEST_MOVE
    x_0, nx = _axis(workspace, anchor_m, spacing, 0)
    y_0, ny = _axis(workspace, anchor_m, spacing, 1)
    if not 0 < nx * ny <= MAX_NODES:
        raise InputError(
            f"a lattice for steps of {step_m:g} m has {nx * ny} nodes within the bounds",
            remedy=f"choose bounds and step for 1 to {MAX_NODES} nodes",
        )
    origin = np.array([x_0, y_0])
    positions = _positions(origin, spacing, (ny, nx))
    index = index_obstacles(workspace)
    near = near_pairs(index, positions.reshape(-1, 2), clearance_m + step_m)
    free = np.ones(nx * ny, dtype=np.bool_)
    free[near.node[~is_clear(near.distance_m, clearance_m)]] = False
    free = free.reshape(ny, nx)
    moves = open_moves(index, positions, free, near, clearance_m)
    return Lattice(origin, spacing, (ny, nx), free, moves)


def node_positions(lattice: Lattice) -> NDArray[np.float64]:
    """Positions of all nodes, ``(ny, nx, 2)`` in metres."""
    return _positions(lattice.origin_m, lattice.spacing_m, lattice.shape)


def nearest_node(lattice: Lattice, position_m: NDArray[np.float64]) -> tuple[int, int]:
    """The ``(iy, ix)`` of the node nearest to `position_m` (2,), free or not."""
    ny, nx = lattice.shape
    ix, iy = np.rint((position_m - lattice.origin_m) / lattice.spacing_m)
    return int(min(max(iy, 0), ny - 1)), int(min(max(ix, 0), nx - 1))


def moves_from(
    index: ObstacleIndex,
    lattice: Lattice,
    position_m: NDArray[np.float64],
    reach_m: float,
    clearance_m: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """First moves of a plan: from a place off the lattice to the nodes around it.

    Parameters
    ----------
    index
        The obstacles that the lattice was built for.
    lattice
        The lattice.
    position_m
        ``(2,)`` where the robot is.
    reach_m
        Longest way.
    clearance_m
        What the straight way must keep; not more than the lattice keeps.

    Returns
    -------
    iy, ix, ok
        ``(n,)`` each: the nodes within reach, and whether the straight way there is open.
    """
    ny, nx = lattice.shape
    place = (position_m - lattice.origin_m) / lattice.spacing_m
    reach = (reach_m + REACH_TOLERANCE_M) / lattice.spacing_m
    low = np.maximum(np.ceil(place - reach), 0.0)
    high = np.minimum(np.floor(place + reach), (nx - 1, ny - 1))
    columns = np.arange(low[0], high[0] + 1, dtype=np.int64)
    rows = np.arange(low[1], high[1] + 1, dtype=np.int64)
    iy, ix = np.repeat(rows, columns.size), np.tile(columns, rows.size)
    within = (ix - place[0]) ** 2 + (iy - place[1]) ** 2 <= reach**2
    iy, ix = iy[within], ix[within]
    ok = lattice.free[iy, ix]
    free = np.flatnonzero(ok)
    ends = lattice.origin_m + lattice.spacing_m * np.column_stack((ix[free], iy[free]))
    starts = np.broadcast_to(position_m, ends.shape)
    way, obstacle = index.tree.query(
        segment_lines(starts, ends), predicate="dwithin", distance=clearance_m
    )
    blocked = blocked_ways(index, starts[way], ends[way], obstacle, clearance_m)
    ok[free[way[blocked]]] = False
    return iy, ix, ok


def _axis(
    workspace: Workspace, anchor_m: NDArray[np.float64], spacing_m: float, dimension: int
) -> tuple[float, int]:
    """First coordinate and number of the nodes strictly between the bounds along one axis."""
    low, high = workspace.bounds_m[dimension], workspace.bounds_m[dimension + 2]
    anchor = float(anchor_m[dimension])
    first = math.floor((low - anchor) / spacing_m) + 1
    last = math.ceil((high - anchor) / spacing_m) - 1
    return anchor + spacing_m * first, max(last - first + 1, 0)


def _positions(
    origin_m: NDArray[np.float64], spacing_m: float, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Node positions ``(ny, nx, 2)``."""
    iy, ix = np.indices(shape)
    return origin_m + spacing_m * np.stack((ix, iy), axis=-1)
