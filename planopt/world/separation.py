"""Separating lines: linear collision constraints on path segments, for the solver.

A line is computed from the initial guess and imposed on both ends of a segment. Relative to the
centre of a moving disc, the robot moves straight during a step, so two constraints suffice, with
the normal n from the centre towards the nearest point of the initial guess::

    n . (q_{k-1} - c_{k-1}) >= R,    n . (q_k - c_k) >= R

On the initial guess, the braking path has a margin ``g = min_t n . (p(t) - c(t)) - R``. If
refinement moves the last position and the rest position by at most g towards the disc, it moves no
position in between by more.
"""

import itertools
import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.arrays import Floats, Mask
from planopt.world.motion import MovingDiscs, TimedMotion, nearest_to_origin_m
from planopt.world.workspace import Workspace

Vertex = tuple[float, float]
Edge = tuple[Vertex, Vertex]

FLAT_M = 1e-9  # Convexity tolerance in metres: depth of a vertex inside the chord of its neighbours


def convex_pieces(polygon: shapely.Polygon) -> tuple[Floats, ...]:
    """Return convex polygons that together equal `polygon`."""
    # Constrained Delaunay triangles are merged across common edges, longest first, while the result
    # stays convex (Hertel and Mehlhorn 1983: at most four times the minimum number of pieces). No
    # vertices are added, so pieces share whole edges.
    outline = _ring(polygon)
    corners = zip(outline[-2:] + outline[:-2], outline[-1:] + outline[:-1], outline, strict=True)
    if not polygon.interiors and all(_is_convex_turn(*corner) for corner in corners):
        return (_corners(outline),)
    triangles = [
        _ring(shapely.Polygon(triangle.exterior))
        for triangle in shapely.constrained_delaunay_triangles(polygon).geoms
        if isinstance(triangle, shapely.Polygon) and triangle.area > 0
    ]
    return tuple(_corners(ring) for ring in _merged(triangles))


def _ring(polygon: shapely.Polygon) -> list[Vertex]:
    """Return the exterior vertices counter-clockwise, not closed, without repetitions."""
    ring = polygon.exterior
    closed = [(float(x), float(y)) for x, y in shapely.get_coordinates(ring)]
    open_ring = [b for a, b in itertools.pairwise(closed) if a != b]
    return open_ring if ring.is_ccw else open_ring[::-1]


def _is_convex_turn(before: Vertex, at: Vertex, after: Vertex) -> bool:
    """Return whether `at` is a left turn, or a right turn within `FLAT_M` of the chord."""
    chord_x, chord_y = after[0] - before[0], after[1] - before[1]
    cross = chord_x * (before[1] - at[1]) - chord_y * (before[0] - at[0])
    return before != after and cross >= -FLAT_M * math.hypot(chord_x, chord_y)


def _corners(ring: list[Vertex]) -> Floats:
    """Return the corners of the convex hull of `ring`, counter-clockwise."""
    hull = shapely.MultiPoint(ring).convex_hull
    if not isinstance(hull, shapely.Polygon):
        raise AssertionError("a piece without area")
    return np.array(_ring(hull))


def _merged(triangles: list[list[Vertex]]) -> list[list[Vertex]]:
    """Return convex rings, merged greedily from a triangulation, longest edges first."""
    pieces = dict(enumerate(triangles))
    owner: dict[Edge, int] = {
        edge: number for number, ring in pieces.items() for edge in _edges(ring)
    }
    common = [(a, b) for a, b in owner if a < b and (b, a) in owner]
    for a, b in sorted(common, key=lambda edge: -math.dist(*edge)):
        kept, gone = owner[a, b], owner[b, a]
        first = _starting_at(pieces[kept], b)
        second = _starting_at(pieces[gone], a)
        if _is_convex_turn(first[-2], a, second[1]) and _is_convex_turn(second[-2], b, first[1]):
            pieces[kept] = first + second[1:-1]
            for edge in _edges(pieces.pop(gone)):
                owner[edge] = kept
    return list(pieces.values())


def _edges(ring: list[Vertex]) -> list[Edge]:
    """Return the directed edges of `ring`, including the closing edge."""
    return list(zip(ring, ring[1:] + ring[:1], strict=True))


def _starting_at(ring: list[Vertex], vertex: Vertex) -> list[Vertex]:
    """Return `ring` rotated so that it starts at `vertex`."""
    start = ring.index(vertex)
    return ring[start:] + ring[:start]


EMPTY_OFFSET_M = -1.0
"""Offset of empty slots. With their zero normals, ``0 . q - (-1) >= 0`` always holds."""


@dataclass(frozen=True)
class PackedPieces:
    """Convex pieces of all obstacles, stored in padded arrays."""

    vertices_m: Floats  # (k, v, 2) corners, counter-clockwise, padded by repeating the last one
    # (k, v, 2) outward unit normals of the edges from those corners, padded by the last one
    normals: Floats
    corners: NDArray[np.int64]  # (k,) number of corners without padding
    # (k, 2) corners of the bounding boxes, for the candidate search
    lower_m: Floats
    upper_m: Floats
    obstacle: NDArray[np.int64]  # (k,) index of each piece's obstacle in the workspace


@dataclass(frozen=True)
class SeparatingLines:
    """Up to c separating lines for each of s segments, nearest pieces first."""

    # Segment ends: ``normal . q - offset >= gap``; corners: ``normal . v <= offset``.

    # (s, c, 2) unit normals, pointing from the piece to the segment; 0 in empty slots
    normals: Floats
    offsets: Floats  # (s, c) in metres; `EMPTY_OFFSET_M` in empty slots
    gaps: Floats  # (s, c) distance in metres, negative for overlaps; infinite in empty slots
    piece: NDArray[np.int64]  # (s, c) index of the piece; -1 in empty slots
    # (s, c) offsets at the segment's start, for lines that move during a step
    start_offsets: Floats

    def rows(self, kept_m: float) -> Floats:
        """Return lines (s, c, 4): normal, and offsets at end and start, increased by `kept_m`."""
        kept = np.where(np.isfinite(self.gaps), kept_m, 0.0)
        offsets = np.stack([self.offsets + kept, self.start_offsets + kept], axis=2)
        return np.concatenate([self.normals, offsets], axis=2)


def empty_lines(segments: int, count: int) -> SeparatingLines:
    """Return a table of `count` empty slots for separating lines per segment."""
    shape = (segments, count)
    return SeparatingLines(
        normals=np.zeros((*shape, 2)),
        offsets=np.full(shape, EMPTY_OFFSET_M),
        gaps=np.full(shape, np.inf),
        piece=np.full(shape, -1, dtype=np.int64),
        start_offsets=np.full(shape, EMPTY_OFFSET_M),
    )


def _columns(lines: SeparatingLines) -> list[NDArray[Any]]:
    return [getattr(lines, each.name) for each in fields(lines)]


def joined_lines(first: SeparatingLines, second: SeparatingLines) -> SeparatingLines:
    """Return the union of two tables of lines for the same segments."""
    columns = zip(_columns(first), _columns(second), strict=True)
    return SeparatingLines(*(np.concatenate(pair, axis=1) for pair in columns))


def split_lines(lines: SeparatingLines, count: int) -> tuple[SeparatingLines, SeparatingLines]:
    """Return the first `count` lines of each segment, and the remaining lines of each segment."""
    first, others = (
        SeparatingLines(*(column[:, some] for column in _columns(lines)))
        for some in (slice(count), slice(count, None))
    )
    return first, others


def pack_pieces(workspace: Workspace) -> PackedPieces:
    """Return the convex pieces of all obstacles, packed into arrays."""
    cut = [convex_pieces(obstacle.polygon) for obstacle in workspace.obstacles]
    rings = [ring for pieces in cut for ring in pieces]
    corners = np.array([len(ring) for ring in rings], dtype=np.int64)
    width = int(corners.max(initial=1))
    vertices = np.zeros((len(rings), width, 2))
    normals = np.zeros((len(rings), width, 2))
    for row, ring in enumerate(rings):
        along = np.roll(ring, -1, axis=0) - ring
        outward = np.column_stack((along[:, 1], -along[:, 0])) / np.hypot(*along.T)[:, None]
        padding = ((0, width - len(ring)), (0, 0))
        vertices[row] = np.pad(ring, padding, mode="edge")
        normals[row] = np.pad(outward, padding, mode="edge")
    return PackedPieces(
        vertices_m=vertices,
        normals=normals,
        corners=corners,
        lower_m=vertices.min(axis=1),
        upper_m=vertices.max(axis=1),
        obstacle=np.repeat(np.arange(len(cut)), [len(pieces) for pieces in cut]),
    )


def separating_lines(
    pieces: PackedPieces, starts_m: Floats, ends_m: Floats, count: int, reach_m: float
) -> SeparatingLines:
    """Return the lines that separate each segment from its nearest pieces."""
    # Shapes: starts_m, ends_m (s, 2).
    segment, piece = _candidates(pieces, starts_m, ends_m, reach_m)
    normals, offsets, gaps = _best_lines(pieces, starts_m[segment], ends_m[segment], piece)
    order = np.lexsort((gaps, segment))
    order = order[gaps[order] <= reach_m]
    ordered = segment[order]
    rank = np.arange(order.size) - np.searchsorted(ordered, ordered)
    chosen = order[rank < count]
    slots = (segment[chosen], rank[rank < count])
    lines = empty_lines(len(starts_m), count)
    _fill(lines, slots, normals[chosen], offsets[chosen], gaps[chosen], piece[chosen])
    return lines


def lines_for(
    pieces: PackedPieces,
    starts_m: Floats,
    ends_m: Floats,
    piece_ids: NDArray[np.int64],  # (s, c)
) -> SeparatingLines:
    """Return the lines that separate each segment from the pieces `piece_ids`."""
    # Shapes: starts_m, ends_m (s, 2).
    slots = np.nonzero(piece_ids >= 0)
    piece = piece_ids[slots]
    best = _best_lines(pieces, starts_m[slots[0]], ends_m[slots[0]], piece)
    lines = empty_lines(piece_ids.shape[0], piece_ids.shape[1])
    _fill(lines, slots, *best, piece)
    return lines


def _fill(
    lines: SeparatingLines,
    slots: Any,
    normals: Floats,
    offsets: Floats | float,
    gaps: Floats | float,
    piece: NDArray[np.int64] | int,
) -> None:
    """Write lines with equal offsets at start and end into the rows `slots` of a table."""
    lines.normals[slots] = normals
    lines.offsets[slots] = lines.start_offsets[slots] = offsets
    lines.gaps[slots] = gaps
    lines.piece[slots] = piece


def _candidates(
    pieces: PackedPieces, starts_m: Floats, ends_m: Floats, reach_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs (segment, piece) whose bounding boxes are within `reach_m` of each other."""
    lower, upper = np.minimum(starts_m, ends_m), np.maximum(starts_m, ends_m)
    # The segments of a plan are close together, so one common box excludes most pieces.
    around_lower = lower.min(axis=0, initial=np.inf) - reach_m
    around_upper = upper.max(axis=0, initial=-np.inf) + reach_m
    near = np.flatnonzero(
        (pieces.upper_m >= around_lower).all(axis=1) & (pieces.lower_m <= around_upper).all(axis=1)
    )
    apart = np.maximum(
        pieces.lower_m[near] - upper[:, None], lower[:, None] - pieces.upper_m[near]
    ).clip(min=0.0)
    segment, column = np.nonzero((apart * apart).sum(axis=2) <= reach_m * reach_m)
    return segment, near[column]


def _best_lines(
    pieces: PackedPieces, starts_m: Floats, ends_m: Floats, piece: NDArray[np.int64]
) -> tuple[Floats, Floats, Floats]:
    """Return normal (p, 2), offset (p,) and gap (p,) of the line of largest gap for each pair."""
    # The gap of a unit normal n is ``min(n . a, n . b) - max(n . v)``. Its maximum over n is the
    # distance of the convex sets, or minus their penetration depth. The maximiser is a normal of an
    # edge of the piece, a normal of the segment, or, if two vertices are nearest, the direction to
    # a segment end from its nearest corner.
    width = int(pieces.corners[piece].max(initial=1))
    # Coordinates relative to the segment's start avoid loss of digits near 3e6.
    corner = pieces.vertices_m[piece, :width] - starts_m[:, None]
    edge_normal = pieces.normals[piece, :width]
    along = ends_m - starts_m

    edge_gap = np.minimum(0.0, _dot(edge_normal, along[:, None])) - _dot(edge_normal, corner)
    across = np.column_stack((-along[:, 1], along[:, 0]))
    from_start, from_end = -corner, along[:, None] - corner
    normals = np.stack(
        (
            across,
            -across,
            _row_of(from_start, _dot(from_start, from_start).argmin(axis=1)),
            _row_of(from_end, _dot(from_end, from_end).argmin(axis=1)),
            _row_of(edge_normal, edge_gap.argmax(axis=1)),
        ),
        axis=1,
    )
    length = np.hypot(normals[..., 0], normals[..., 1])
    normals /= np.where(length > 0.0, length, 1.0)[..., None]
    support = _dot(normals[:, :, None], corner[:, None]).max(axis=2)
    gap = np.where(length > 0.0, np.minimum(0.0, _dot(normals, along[:, None])) - support, -np.inf)
    best = gap.argmax(axis=1)
    normal = _row_of(normals, best)
    return normal, _dot(normal, starts_m) + _row_of(support, best), _row_of(gap, best)


def _dot(a: Floats, b: Floats) -> Floats:
    """Return dot products over the last axis of length 2."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _row_of(table: Floats, column: NDArray[np.int64]) -> Floats:
    """Return ``table[i, column[i]]`` for each row i of `table` (p, w, ...)."""
    return table[np.arange(len(table)), column]


TOUCHING_M = 1e-9  # Distance in metres below which the line for a disc is parallel to the segment


def moving_lines(
    discs: MovingDiscs,
    path_m: Floats,  # (N + 1, 2) initial guess, from the robot's position
    clearance_m: float,
    count: int,
    reach_m: float,
    needed: Mask | None = None,  # (m, N)
    pad_m: float = 0.0,
) -> SeparatingLines:
    """Return the lines that separate each segment from its nearest moving discs."""
    # They touch the disc, whose radius is changed by the difference of required distances.
    steps = len(path_m) - 1
    lines = empty_lines(steps, count)
    relative = path_m - discs.centres_m[:, : len(path_m)]
    begin, end = relative[:, :-1], relative[:, 1:]
    nearest = nearest_to_origin_m(begin, end)
    distance = np.linalg.norm(nearest, axis=-1)
    along = end - begin
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    normal = np.where(distance[..., None] > TOUCHING_M, nearest, across)
    length = np.linalg.norm(normal, axis=-1)
    normal = np.where(length[..., None] > 0.0, normal, [1.0, 0.0])
    normal = normal / np.where(length > 0.0, length, 1.0)[..., None]
    size = discs.apart_m[:, :steps] - clearance_m + pad_m
    gaps = distance - size
    first = np.zeros(gaps.shape) if needed is None else np.where(needed, -np.inf, 0.0)
    order = np.argsort(np.minimum(gaps, np.inf) + first, axis=0, kind="stable")[:count]
    for row, disc in enumerate(order):
        step = np.arange(steps)
        kept = (gaps[disc, step] <= reach_m) | np.isinf(first[disc, step])
        disc, step = disc[kept], step[kept]
        n, touching = normal[disc, step], size[disc, step]
        offsets = _dot(n, discs.centres_m[disc, step + 1]) + touching
        _fill(lines, (step, row), n, offsets, gaps[disc, step], disc)
        lines.start_offsets[step, row] = _dot(n, discs.centres_m[disc, step]) + touching
    return lines


FAR_M = 1e4  # Offset in metres that makes a line ineffective at the start of a step


def tail_lines(
    discs: MovingDiscs,
    motion: TimedMotion,
    planned: int,
    standstill_m: Floats,  # (2,)
    clearance_m: float,
    count: int,
    reach_m: float,
) -> tuple[SeparatingLines, SeparatingLines]:
    """Return separating lines for the last planned position, and for the position of rest."""
    last, still = empty_lines(planned, count), empty_lines(1, count)
    whole = motion.lasting(discs.steps)
    own, bulges = whole.places_m[planned:], whole.bulges_m[planned:]
    found: list[tuple[float, Floats]] = []
    for number in range(len(discs)):
        steps = discs.counted_steps(number, motion)
        if steps <= planned:
            continue
        size = discs.apart_m[number, planned:steps] + bulges[: steps - planned] - clearance_m
        relative = (own - discs.centres_m[number, planned:])[: steps - planned + 1]
        nearest = nearest_to_origin_m(relative[:-1], relative[1:])
        distance = np.linalg.norm(nearest, axis=1)
        at = int(np.argmin(distance - size))
        if distance[at] - size[at] > reach_m or distance[at] <= TOUCHING_M:
            continue
        normal = nearest[at] / distance[at]
        along = relative @ normal
        gap = float((np.minimum(along[:-1], along[1:]) - size).min())
        found.append((gap, normal))
    found.sort(key=lambda each: each[0])
    for row, (gap, normal) in enumerate(found[:count]):
        ends = np.stack([own[0], standstill_m]) @ normal - gap
        for lines, segment, end in ((last, planned - 1, ends[0]), (still, 0, ends[1])):
            _fill(lines, (segment, row), normal, end, gap, row)
        last.start_offsets[planned - 1, row] -= FAR_M
    return last, still
