"""Which moves between lattice nodes keep the clearance: exact, with few questions to GEOS.

The distance to an obstacle changes by at most one metre a metre, so a straight way of length l
between places at distances d_a and d_b from an obstacle stays ``(d_a + d_b - l) / 2`` or more away
from it. Only ways that this bound leaves open are measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.world.clearance import ObstacleIndex, distances_m, is_clear, segment_lines

_TESTED = ((1, 0), (0, 1), (1, 1), (-1, 1), (2, 1), (1, 2), (-1, 2), (-2, 1))
_DOUBLED = ((1, 0), (0, 1))
_FORWARD = (*_TESTED, *((2 * dx, 2 * dy) for dx, dy in _DOUBLED))

MOVES: NDArray[np.int64] = np.array([(0, 0), *_FORWARD, *((-dx, -dy) for dx, dy in _FORWARD)])
"""(21, 2) the moves (dx, dy) with dx^2 + dy^2 <= 5; move k + 10 undoes move k, k = 1 to 10."""
MOVES.flags.writeable = False


@dataclass(frozen=True)
class NearPairs:
    """Nodes and the obstacles near them.

    Attributes
    ----------
    node
        ``(p,)`` numbers into the positions asked for.
    obstacle
        ``(p,)`` numbers into the index.
    distance_m
        ``(p,)`` their distance, exact.
    """

    node: NDArray[np.int64]
    obstacle: NDArray[np.int64]
    distance_m: NDArray[np.float64]


def near_pairs(index: ObstacleIndex, positions_m: NDArray[np.float64], reach_m: float) -> NearPairs:
    """All pairs of a position (n, 2) and an obstacle within `reach_m` of it."""
    points = np.asarray(shapely.points(positions_m), np.object_)
    node, obstacle = index.tree.query(points, predicate="dwithin", distance=reach_m)
    return NearPairs(node, obstacle, distances_m(points[node], index.polygons[obstacle]))


def blocked_ways(
    index: ObstacleIndex,
    starts_m: NDArray[np.float64],
    ends_m: NDArray[np.float64],
    obstacle: NDArray[np.int64],
    clearance_m: float,
) -> NDArray[np.bool_]:
    """Whether each straight way (n, 2) comes nearer than the clearance to its obstacle (n,)."""
    lines = segment_lines(starts_m, ends_m)
    return ~is_clear(distances_m(lines, index.polygons[obstacle]), clearance_m)


def open_moves(
    index: ObstacleIndex,
    positions_m: NDArray[np.float64],
    free: NDArray[np.bool_],
    near: NearPairs,
    clearance_m: float,
) -> NDArray[np.bool_]:
    """Whether the way from every node along every move ends on a node and keeps the clearance.

    Parameters
    ----------
    index
        The obstacles.
    positions_m
        ``(ny, nx, 2)`` node positions.
    free
        ``(ny, nx)`` nodes that keep the clearance.
    near
        Pairs of a node (counted row by row) and an obstacle, at least all within the clearance
        plus the longest move.
    clearance_m
        Least distance from every obstacle.

    Returns
    -------
    (21, ny, nx) array
        In the order of `MOVES`. Half of the moves are tested, the others are the same ways
        driven back, and a straight move of two spacings is two moves of one.
    """
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
        blocked = blocked_ways(index, places[node], places[node + stride], obstacle, clearance_m)
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
