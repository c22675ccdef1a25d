"""Lattice of the global search: free nodes, moves between them, and shortest paths.

The spacing is step / sqrt(5), so that the longest of the 21 moves, a knight's move, is a full step.
A segment of length l whose ends are at distances d_a and d_b from an obstacle is at least
``(d_a + d_b - l) / 2`` away from it; GEOS is called only if this bound is inconclusive.

The nodes of a regular lattice miss a passage between obstacles if its free space, in which the
robot keeps the clearance, is narrower than the spacing. Such passages are found by morphological
opening with a disc. A node whose cell a passage crosses is moved into the passage.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from planopt.arrays import Floats, Indices, Mask
from planopt.errors import InputError
from planopt.world.clearance import (
    ObstacleIndex,
    clearance_m,
    distances_m,
    index_obstacles,
    is_clear,
    segment_lines,
    segments_clear,
)
from planopt.world.workspace import LONGEST_MOVE, Workspace

DISC_RADIUS = 0.5
"""Radius of the disc, in lattice spacings. A strip as wide as the spacing contains nodes."""

DISC_SLACK = 1.01  # Growth of the opened space, so that polygonal arcs leave no slivers

CROSSED = 0.3
"""Least diagonal of the part of a passage in a cell for which its node is moved, in spacings."""

SAME_M = 1e-6  # Distance within which two positions are the same, in metres

TOUCHING = 0.05
"""Distance from the obstacles' clearance, in disc radii, up to which a boundary belongs to it."""


def nodes_in_passages(
    workspace: Workspace,
    index: ObstacleIndex,
    positions_m: Floats,  # (ny, nx, 2) of the regular nodes
    anchor_m: Floats,  # (2,) position of a node that stays
    spacing_m: float,
    required_m: float,
) -> tuple[Indices, Floats]:
    """Return indices (iy, ix) of nodes to move into narrow passages, and their new positions."""
    passages = narrow_passages(workspace, index, DISC_RADIUS * spacing_m, required_m)
    if not len(passages):
        return np.zeros((0, 2), np.intp), np.zeros((0, 2))
    ny, nx = positions_m.shape[:2]
    bounds = (_corners(passages) - positions_m[0, 0]) / spacing_m
    first, last = np.clip(np.rint(bounds).astype(np.intp), 0, (nx - 1, ny - 1)).swapaxes(0, 1)
    around = [
        low[::-1] + np.argwhere(np.ones((high - low + 1)[::-1], np.bool_))
        for low, high in zip(first, last, strict=True)
    ]
    nodes: Indices = np.concatenate(around)
    numbers: Indices = np.repeat(np.arange(len(passages)), [len(each) for each in around])
    centres, half = positions_m[nodes[:, 0], nodes[:, 1]], 0.5 * spacing_m
    (left, low), (right, high) = (centres - half).T, (centres + half).T
    cells = np.asarray(shapely.box(left, low, right, high), np.object_)
    crossings = shapely.intersection(cells, passages[numbers])
    parts, whole = shapely.get_parts(crossings, return_index=True)
    crossed = _corners(parts)
    kept = np.linalg.norm(crossed[:, 1] - crossed[:, 0], axis=1) > CROSSED * spacing_m
    kept &= np.linalg.norm(centres[whole] - anchor_m, axis=1) > half
    parts, nodes = parts[kept], nodes[whole[kept]]
    area: Floats = shapely.area(parts)  # pyright: ignore[reportUnknownMemberType]
    order = np.argsort(-area, kind="stable")
    parts, nodes = parts[order], nodes[order]
    places = _centred(index, parts, 2.0 * half)
    clear = is_clear(clearance_m(index, places), required_m)
    nodes, places = nodes[clear], places[clear]
    _, largest = np.unique(nodes[:, 0] * nx + nodes[:, 1], return_index=True)
    return nodes[largest], places[largest]


def _corners(shapes: NDArray[np.object_]) -> Floats:
    """Return the lower and upper corners (k, 2, 2) of the bounding boxes of shapes."""
    bounds: Floats = shapely.bounds(shapes)  # pyright: ignore[reportUnknownMemberType]
    return bounds.reshape(-1, 2, 2)


def _centred(index: ObstacleIndex, parts: NDArray[np.object_], longest_m: float) -> Floats:
    """Return a position (k, 2) in each part, midway between the sides of the passage."""
    inside = shapely.centroid(parts)
    places = shapely.get_coordinates(inside)
    near = index.polygons[index.tree.query_nearest(inside, all_matches=False)[1]]
    gaps: NDArray[np.object_] = shapely.shortest_line(near, inside)  # pyright: ignore
    feet = shapely.get_coordinates(gaps)[::2]
    across = places - feet
    across *= longest_m / np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
    lines = shapely.intersection(segment_lines(places - across, places + across), parts)
    chords, part = shapely.get_parts(lines, return_index=True)
    own = shapely.dwithin(chords, inside[part], SAME_M)
    part, middles = part[own], shapely.get_coordinates(shapely.centroid(chords[own]))
    # At the mouth, the line to the nearest obstacle does not cross the passage at right angles.
    wider = clearance_m(index, middles) > clearance_m(index, places[part])
    places[part[wider]] = middles[wider]
    return places


def narrow_passages(
    workspace: Workspace, index: ObstacleIndex, radius_m: float, required_m: float
) -> NDArray[np.object_]:
    """Return the parts of free space that connect wider parts but are too narrow for the disc."""
    covered = shapely.union_all(shapely.buffer(index.polygons, required_m))
    box = shapely.box(*workspace.bounds_m)
    free = box.difference(covered)
    wide = free.buffer(-radius_m, quad_segs=4).buffer(DISC_SLACK * radius_m, quad_segs=4)
    narrow = shapely.get_parts(free.difference(wide))
    narrow = narrow[np.ptp(_corners(narrow), axis=1).max(axis=1, initial=0.0) > SAME_M]
    rings: NDArray[np.object_] = shapely.get_exterior_ring(narrow)  # pyright: ignore
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    middles = 0.5 * (corners[:-1] + corners[1:])[ring[:-1] == ring[1:]]
    ring = ring[:-1][ring[:-1] == ring[1:]]
    low, high = np.array(workspace.bounds_m[:2]), np.array(workspace.bounds_m[2:])
    away = np.minimum(
        clearance_m(index, middles) - required_m,
        np.minimum(middles - low, high - middles).min(axis=1, initial=np.inf),
    )
    opens = away > TOUCHING * radius_m
    first = np.searchsorted(ring, ring)
    before = np.arange(len(ring)) - 1
    before[before < first] = np.searchsorted(ring, ring[before < first], side="right") - 1
    mouths = np.bincount(ring[opens & ~opens[before]], minlength=len(narrow))
    return narrow[mouths > 1]


_TESTED = ((1, 0), (0, 1), (1, 1), (-1, 1), (2, 1), (1, 2), (-1, 2), (-2, 1))
_DOUBLED = ((1, 0), (0, 1))
_FORWARD = (*_TESTED, *((2 * dx, 2 * dy) for dx, dy in _DOUBLED))

MOVES: NDArray[np.int64] = np.array([(0, 0), *_FORWARD, *((-dx, -dy) for dx, dy in _FORWARD)])
"""(21, 2) moves (dx, dy) with dx^2 + dy^2 <= 5; move k + 10 reverses move k, k = 1 to 10."""
MOVES.flags.writeable = False

REVERSE: Indices = np.r_[0, 11:21, 1:11]  # (21,) index of the move that reverses each move


MAX_NODES = 10_000_000
"""Maximum number of nodes, whose moves take 210 MB. More nodes suggest a wrong step or bounds."""
REACH_TOLERANCE_M = 1e-9  # Tolerance in metres for nodes at exactly `reach_m`

ROUNDING_M = 1e-6  # Difference between lengths of moves that is due to rounding, in metres


@dataclass(frozen=True)
class Lattice:
    """Square lattice over the workspace."""

    origin_m: Floats  # (2,) regular position of node [0, 0]
    spacing_m: float  # Distance between neighbours
    shape: tuple[int, int]  # (ny, nx)
    free: Mask  # (ny, nx) True for nodes that keep the clearance
    # (21, ny, nx) True if MOVES[k] from the node ends on a node and keeps the clearance
    open_moves: Mask
    positions_m: Floats  # (ny, nx, 2)
    moved: Indices  # (k, 2) nodes (iy, ix) that are moved within their cells into narrow passages


def build_lattice(
    workspace: Workspace, anchor_m: Floats, step_m: float, clearance_m: float
) -> Lattice:
    """Return the lattice inside the workspace bounds with a node at `anchor_m` (2,)."""
    spacing = step_m / LONGEST_MOVE
    x_0, nx = _axis(workspace, anchor_m, spacing, 0)
    y_0, ny = _axis(workspace, anchor_m, spacing, 1)
    if not 0 < nx * ny <= MAX_NODES:
        raise InputError(
            f"a search lattice for steps of {step_m:g} m has {nx * ny} nodes within the bounds",
            remedy=f"change bounds, speed or step time so that it has 1 to {MAX_NODES} nodes",
        )
    origin = np.array([x_0, y_0])
    positions = _positions(origin, spacing, (ny, nx))
    index = index_obstacles(workspace)
    points = np.asarray(shapely.points(positions.reshape(-1, 2)), np.object_)
    nearby, obstacle = index.tree.query(points, predicate="dwithin", distance=clearance_m + step_m)
    near = NearPairs(nearby, obstacle, distances_m(points[nearby], index.polygons[obstacle]))
    free = np.ones(nx * ny, dtype=np.bool_)
    free[near.node[~is_clear(near.distance_m, clearance_m)]] = False
    free = free.reshape(ny, nx)
    moves = open_moves(index, positions, free, near, clearance_m)
    moved, places = nodes_in_passages(workspace, index, positions, anchor_m, spacing, clearance_m)
    free[moved[:, 0], moved[:, 1]] = True
    positions[moved[:, 0], moved[:, 1]] = places
    _open_passages(index, positions, free, moves, moved, step_m, clearance_m)
    return Lattice(origin, spacing, (ny, nx), free, moves, positions, moved)


def _open_passages(
    index: ObstacleIndex,
    positions_m: Floats,  # (ny, nx, 2)
    free: Mask,
    moves: Mask,  # (21, ny, nx)
    moved: Indices,  # (k, 2)
    step_m: float,
    clearance_m: float,
) -> None:
    """Set moves to and from moved nodes: open if collision-free and at most a step long."""
    start = np.repeat(moved, len(MOVES), axis=0)
    end = (moved[:, None] + MOVES[:, ::-1]).reshape(-1, 2)
    move = np.tile(np.arange(len(MOVES)), len(moved))
    back = np.tile(REVERSE, len(moved))
    inside = ((end >= 0) & (end < free.shape)).all(axis=1)
    start, end, move, back = start[inside], end[inside], move[inside], back[inside]
    begins, ends = (positions_m[each[:, 0], each[:, 1]] for each in (start, end))
    opened = free[end[:, 0], end[:, 1]]
    opened &= np.linalg.norm(ends - begins, axis=1) <= step_m + REACH_TOLERANCE_M
    opened[opened] = segments_clear(index, begins[opened], ends[opened], clearance_m)
    moves[move, start[:, 0], start[:, 1]] = opened
    moves[back, end[:, 0], end[:, 1]] = opened


def nearest_node(lattice: Lattice, position_m: Floats) -> tuple[int, int]:
    """Return the index ``(iy, ix)`` of the node nearest to `position_m` (2,), free or not."""
    ny, nx = lattice.shape
    ix, iy = np.rint((position_m - lattice.origin_m) / lattice.spacing_m)
    return int(min(max(iy, 0), ny - 1)), int(min(max(ix, 0), nx - 1))


def moves_from(
    index: ObstacleIndex,
    lattice: Lattice,
    position_m: Floats,  # (2,) position of the robot
    reach_m: float,
    clearance_m: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
    """Return indices iy and ix of nodes in reach, and a mask of those on collision-free lines."""
    ny, nx = lattice.shape
    place = (position_m - lattice.origin_m) / lattice.spacing_m
    reach = reach_m / lattice.spacing_m + 0.5
    low = np.maximum(np.ceil(place - reach), 0.0)
    high = np.minimum(np.floor(place + reach), (nx - 1, ny - 1))
    columns = np.arange(low[0], high[0] + 1, dtype=np.int64)
    rows = np.arange(low[1], high[1] + 1, dtype=np.int64)
    iy, ix = np.repeat(rows, columns.size), np.tile(columns, rows.size)
    away = np.linalg.norm(lattice.positions_m[iy, ix] - position_m, axis=1)
    within = away <= reach_m + REACH_TOLERANCE_M
    iy, ix = iy[within], ix[within]
    ok = lattice.free[iy, ix]
    free = np.flatnonzero(ok)
    ends = lattice.positions_m[iy[free], ix[free]]
    starts = np.broadcast_to(position_m, ends.shape)
    ok[free] = segments_clear(index, starts, ends, clearance_m)
    return iy, ix, ok


def _axis(
    workspace: Workspace, anchor_m: Floats, spacing_m: float, dimension: int
) -> tuple[float, int]:
    """Return the first coordinate and the number of nodes along an axis, inside the bounds."""
    low, high = workspace.bounds_m[dimension], workspace.bounds_m[dimension + 2]
    anchor = float(anchor_m[dimension])
    first = math.floor((low - anchor) / spacing_m) + 1
    last = math.ceil((high - anchor) / spacing_m) - 1
    return anchor + spacing_m * first, max(last - first + 1, 0)


def _positions(origin_m: Floats, spacing_m: float, shape: tuple[int, int]) -> Floats:
    """Return node positions (ny, nx, 2)."""
    iy, ix = np.indices(shape)
    return origin_m + spacing_m * np.stack((ix, iy), axis=-1)


@dataclass(frozen=True)
class NearPairs:
    """Pairs of a node and a nearby obstacle."""

    node: NDArray[np.int64]  # (p,) indices into the positions
    obstacle: NDArray[np.int64]  # (p,) indices into the obstacle index
    distance_m: Floats  # (p,) exact distances


def open_moves(
    index: ObstacleIndex, positions_m: Floats, free: Mask, near: NearPairs, clearance_m: float
) -> Mask:
    """Return a mask (21, ny, nx) of moves that start and end at free nodes and keep clearance."""
    # Shapes: positions_m (ny, nx, 2), node positions; free (ny, nx), nodes that keep the clearance.
    result = np.zeros((len(MOVES), *free.shape), dtype=np.bool_)
    result[0] = free
    places = positions_m.reshape(-1, 2)
    order = np.lexsort((near.obstacle, near.node))
    order = order[free.reshape(-1)[near.node[order]]]
    undecided = NearPairs(near.node[order], near.obstacle[order], near.distance_m[order])
    for number, (dx, dy) in enumerate(_TESTED, start=1):
        start, end = _ends(free.shape, dx, dy)
        result[number][start] = free[start] & free[end]
        moves = result[number].reshape(-1)
        stride = dy * free.shape[1] + dx
        node, obstacle = _unsure(undecided, moves, stride, places, clearance_m, len(index.polygons))
        lines = segment_lines(places[node], places[node + stride])
        blocked = ~is_clear(distances_m(lines, index.polygons[obstacle]), clearance_m)
        moves[node[blocked]] = False
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
    """Return the slices of start nodes and end nodes of the move (dx, dy)."""
    ny, nx = shape
    start = (slice(max(-dy, 0), max(ny - dy, 0)), slice(max(-dx, 0), max(nx - dx, 0)))
    end = (slice(max(dy, 0), max(ny + dy, 0)), slice(max(dx, 0), max(nx + dx, 0)))
    return start, end


def _unsure(
    near: NearPairs, moves: Mask, stride: int, places_m: Floats, clearance_m: float, obstacles: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return indices of start node and obstacle of moves the Lipschitz bound does not decide."""
    # Shapes: moves (nodes,).
    # A move is undecided only if both ends are among the pairs, because an end outside the pairs is
    # farther away than clearance plus move length.
    from_open = np.flatnonzero(moves[near.node])
    start = near.node[from_open]
    length = np.hypot(*(places_m[start + stride] - places_m[start]).T)
    key = near.node * obstacles + near.obstacle
    end_key = key[from_open] + stride * obstacles
    end = np.minimum(np.searchsorted(key, end_key), key.size - 1)
    both = near.distance_m[from_open] + near.distance_m[end]
    unsure = (key[end] == end_key) & (both < length + 2.0 * clearance_m)
    return start[unsure], near.obstacle[from_open[unsure]]


@dataclass(frozen=True)
class RoadMap:
    """Graph of the free lattice nodes, in row-major order, and the moves between them."""

    lattice: Lattice  # Lattice of the nodes
    nodes_m: Floats  # (n, 2) positions
    rows: Indices  # (n,) lattice indices iy, ix
    columns: Indices
    number: Indices  # (ny, nx) node index, -1 if not free
    # (n, 21) node from which each of `MOVES` arrives here; n if the move is blocked
    sources: Indices
    lengths_m: Floats  # (21,) lengths of the moves between regular nodes
    edge_from: NDArray[np.int32]  # Moves except "stay" in compressed sparse rows
    edge_to: NDArray[np.int32]
    edge_length_m: Floats
    edge_start: NDArray[np.int32]


@dataclass(frozen=True)
class CostToGo:
    """Cheapest paths from each node to a goal."""

    cost_m: Floats  # (n,) weighted path length; infinite without a path or beyond the limit
    # (n,) next node on the path; negative at the goal and without a path
    next_node: NDArray[np.int32]


def build_road_map(lattice: Lattice) -> RoadMap:
    """Return the graph of a lattice's free nodes and the collision-free moves between them."""
    rows, columns = np.nonzero(lattice.free)
    count = len(rows)
    number = np.full(lattice.shape, -1, dtype=np.intp)
    number[rows, columns] = np.arange(count)
    moves = np.asarray(MOVES)
    # Blocked moves lead to the dummy node `count` of infinite cost.
    targets = np.full((count, len(moves)), count, dtype=np.intp)
    sources = np.full((count, len(moves)), count, dtype=np.intp)
    for k, (dx, dy) in enumerate(moves):
        here = np.nonzero(lattice.open_moves[k, rows, columns])[0]
        there = number[rows[here] + dy, columns[here] + dx]
        targets[here, k] = there
        sources[there, k] = here
    lengths = lattice.spacing_m * np.hypot(moves[:, 0], moves[:, 1])
    is_edge = (targets < count) & (lengths > 0.0)
    edge_from, move = np.nonzero(is_edge)
    edge_start = np.concatenate([[0], np.cumsum(is_edge.sum(axis=1))])
    nodes, edge_to = lattice.positions_m[rows, columns], targets[edge_from, move]
    edge_length = lengths[move]
    if len(lattice.moved):
        along = np.linalg.norm(nodes[edge_to] - nodes[edge_from], axis=1)
        edge_length = np.where(np.abs(along - edge_length) > ROUNDING_M, along, edge_length)
    return RoadMap(
        lattice=lattice,
        nodes_m=nodes,
        rows=rows,
        columns=columns,
        number=number,
        sources=sources,
        lengths_m=lengths,
        edge_from=edge_from.astype(np.int32),
        edge_to=edge_to.astype(np.int32),
        edge_length_m=edge_length,
        edge_start=edge_start.astype(np.int32),
    )


def lattice_paths(
    road_map: RoadMap,
    goal_node: int,
    node_factor: Floats | None = None,  # (n,) at least 1, or None for plain lengths
    *,
    limit_m: float = math.inf,
) -> CostToGo:
    """Return cheapest paths to a goal, with edges weighted by the mean factor of both nodes."""
    weights = road_map.edge_length_m
    if node_factor is not None:
        # Edges are sorted by first end, so repeating is twice as fast as indexing both ends.
        ends = np.repeat(node_factor, np.diff(road_map.edge_start))
        ends += node_factor.take(road_map.edge_to)
        ends *= weights
        ends *= 0.5
        weights = ends
    return cheapest_paths(road_map, goal_node, weights, limit_m=limit_m)


def cheapest_paths(
    road_map: RoadMap, goal_node: int, edge_cost_m: Floats, *, limit_m: float = math.inf
) -> CostToGo:
    """Return the cheapest paths to a goal for symmetric edge costs (e,)."""
    count = len(road_map.nodes_m)
    graph = csr_matrix((edge_cost_m, road_map.edge_to, road_map.edge_start), shape=(count, count))
    cost, following = cast(
        "tuple[Floats, NDArray[np.int32]]",
        cast("Any", dijkstra)(graph, indices=goal_node, return_predecessors=True, limit=limit_m),
    )
    return CostToGo(cost_m=cost, next_node=following)


def route_from(road_map: RoadMap, cost_to_go: CostToGo, node: int, length_m: float) -> Indices:
    """Return the nodes along the first `length_m` of the cheapest path from `node`."""
    nodes = [node]
    travelled = 0.0
    while travelled < length_m:
        following = int(cost_to_go.next_node[nodes[-1]])
        if following < 0:
            break
        travelled += float(
            np.linalg.norm(road_map.nodes_m[following] - road_map.nodes_m[nodes[-1]])
        )
        nodes.append(following)
    return np.asarray(nodes, dtype=np.intp)


def node_at(road_map: RoadMap, place_m: Floats) -> int:
    """Return the index of the node nearest to `place_m` (2,); negative for a blocked node."""
    row, column = nearest_node(road_map.lattice, place_m)
    return int(road_map.number[row, column])


def nodes_in_reach(
    road_map: RoadMap, index: ObstacleIndex, position_m: Floats, reach_m: float, clearance_m: float
) -> tuple[Indices, Floats]:
    """Return indices and distances of the nodes that a straight move from a position reaches."""
    rows, columns, clear = moves_from(index, road_map.lattice, position_m, reach_m, clearance_m)
    nodes = road_map.number[rows[clear], columns[clear]]
    nodes = nodes[nodes >= 0]
    return nodes, np.linalg.norm(road_map.nodes_m[nodes] - position_m, axis=1)
