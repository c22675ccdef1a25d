"""The lattice of the global search: which nodes are free and which moves between them are.

Spacing is step / sqrt(5), so that the longest of the 21 moves, a knight's, is one full step.
Nodes and moves keep the clearance by the same exact distances that the
verifier measures.

Which moves between lattice nodes keep the clearance: exact, with few questions to GEOS.

The distance to an obstacle changes by at most one metre a metre, so a straight way of length l
between places at distances d_a and d_b from an obstacle stays ``(d_a + d_b - l) / 2`` or more away
from it. Only ways that this bound leaves open are measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.world.clearance import (
    ObstacleIndex,
    distances_m,
    index_obstacles,
    is_clear,
    segment_lines,
)
from planopt.world.workspace import LONGEST_MOVE, Workspace

_TESTED = ((1, 0), (0, 1), (1, 1), (-1, 1), (2, 1), (1, 2), (-1, 2), (-2, 1))
_DOUBLED = ((1, 0), (0, 1))
_FORWARD = (*_TESTED, *((2 * dx, 2 * dy) for dx, dy in _DOUBLED))

MOVES: NDArray[np.int64] = np.array([(0, 0), *_FORWARD, *((-dx, -dy) for dx, dy in _FORWARD)])
"""(21, 2) the moves (dx, dy) with dx^2 + dy^2 <= 5; move k + 10 undoes move k, k = 1 to 10."""
MOVES.flags.writeable = False


@dataclass(frozen=True)
class NearPairs:
    """Nodes and the obstacles near them."""

    node: NDArray[np.int64]  # (p,) numbers into the positions asked for
    obstacle: NDArray[np.int64]  # (p,) numbers into the index
    distance_m: NDArray[np.float64]  # (p,) their distance, exact


def near_pairs(index: ObstacleIndex, positions_m: NDArray[np.float64], reach_m: float) -> NearPairs:
    """Return all pairs of a position (n, 2) and an obstacle within `reach_m` of it."""
    points = np.asarray(shapely.points(positions_m), np.object_)
    node, obstacle = index.tree.query(points, predicate="dwithin", distance=reach_m)
    return NearPairs(node, obstacle, distances_m(points[node], index.polygons[obstacle]))


def blocked_segments(
    index: ObstacleIndex,
    starts_m: NDArray[np.float64],
    ends_m: NDArray[np.float64],
    obstacle: NDArray[np.int64],
    clearance_m: float,
) -> NDArray[np.bool_]:
    """Return whether straight ways (n, 2) come nearer than the clearance to obstacles (n,)."""
    lines = segment_lines(starts_m, ends_m)
    return ~is_clear(distances_m(lines, index.polygons[obstacle]), clearance_m)


def open_moves(
    index: ObstacleIndex,
    positions_m: NDArray[np.float64],  # (ny, nx, 2) node positions
    free: NDArray[np.bool_],  # (ny, nx) nodes that keep the clearance
    near: NearPairs,
    clearance_m: float,
) -> NDArray[np.bool_]:
    """Return whether every node's moves end on a node and keep the clearance."""
    result = np.zeros((len(MOVES), *free.shape), dtype=np.bool_)
    result[0] = free
    places = positions_m.reshape(-1, 2)
    undecided = _of_free_nodes(near, free)
    for number, (dx, dy) in enumerate(_TESTED, start=1):
        start, end = _ends(free.shape, dx, dy)
        result[number][start] = free[start] & free[end]
        ways = result[number].reshape(-1)
        stride = dy * free.shape[1] + dx
        node, obstacle = _unsure(undecided, ways, stride, places, clearance_m, len(index.polygons))
        blocked = blocked_segments(
            index, places[node], places[node + stride], obstacle, clearance_m
        )
        ways[node[blocked]] = False
    for number, (dx, dy) in enumerate(_DOUBLED, start=len(_TESTED) + 1):
        once = result[1 + _TESTED.index((dx, dy))]
        start, end = _ends(free.shape, dx, dy)
        result[number][start] = once[start] & once[end]
    for number, (dx, dy) in enumerate(_FORWARD, start=1):
        start, end = _ends(free.shape, dx, dy)
        result[number + len(_FORWARD)][end] = result[number][start]
    return result


def _ends(
    shape: tuple[int, ...], dx: int, dy: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Nodes that the move (dx, dy) can start from, and the nodes where it then ends."""
    ny, nx = shape
    start = (slice(max(-dy, 0), max(ny - dy, 0)), slice(max(-dx, 0), max(nx - dx, 0)))
    end = (slice(max(dy, 0), max(ny + dy, 0)), slice(max(dx, 0), max(nx + dx, 0)))
    return start, end


def _of_free_nodes(near: NearPairs, free: NDArray[np.bool_]) -> NearPairs:
    """The pairs whose node is free, sorted by node and then obstacle."""
    order = np.lexsort((near.obstacle, near.node))
    order = order[free.reshape(-1)[near.node[order]]]
    return NearPairs(near.node[order], near.obstacle[order], near.distance_m[order])


def _unsure(
    near: NearPairs,
    ways: NDArray[np.bool_],
    stride: int,
    places_m: NDArray[np.float64],
    clearance_m: float,
    obstacles: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Start node and obstacle of the `ways` (nodes,) that the Lipschitz bound does not clear.

    A way is unsure only if both of its ends are among the pairs: an end that is not is at least
    the clearance and the way's length away, and the other end at least the clearance.
    """
    asked = np.flatnonzero(ways[near.node])
    start = near.node[asked]
    length = np.hypot(*(places_m[start + stride] - places_m[start]).T)
    key = near.node * obstacles + near.obstacle
    wanted = key[asked] + stride * obstacles
    found = np.minimum(np.searchsorted(key, wanted), key.size - 1)
    both = near.distance_m[asked] + near.distance_m[found]
    unsure = (key[found] == wanted) & (both < length + 2.0 * clearance_m)
    return start[unsure], near.obstacle[asked[unsure]]


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
    """A square lattice over the workspace."""

    origin_m: NDArray[np.float64]  # (2,) position of node [0, 0]
    spacing_m: float  # Distance of neighbours
    shape: tuple[int, int]  # (ny, nx)
    free: NDArray[np.bool_]  # (ny, nx) whether the node keeps the clearance
    # (21, ny, nx) whether the way from the node along MOVES[k] ends on a node and keeps the
    # clearance
    open_moves: NDArray[np.bool_]


def build_lattice(
    workspace: Workspace, anchor_m: NDArray[np.float64], step_m: float, clearance_m: float
) -> Lattice:
    """Lay the lattice through `anchor_m` (2,) over the inside of the bounds."""
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
    position_m: NDArray[np.float64],  # (2,) where the robot is
    reach_m: float,
    clearance_m: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """First moves of a plan: from a place off the lattice to the nodes around it."""
    # Shapes: returns (n,).
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
    blocked = blocked_segments(index, starts[way], ends[way], obstacle, clearance_m)
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
