"""Cut a footprint into convex pieces, because a separating line needs a convex obstacle.

Done once per footprint for the solver. The verifier looks at the footprint as it is.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import shapely
from numpy.typing import NDArray

Vertex = tuple[float, float]
Edge = tuple[Vertex, Vertex]

FLAT_M = 1e-9
"""A vertex this little inside the chord of its neighbours still counts as convex."""


def convex_pieces(polygon: shapely.Polygon) -> tuple[NDArray[np.float64], ...]:
    """Convex polygons that together are exactly `polygon`.

    The constrained Delaunay triangles are merged over their common edges, longest first, as long
    as the result stays convex (Hertel and Mehlhorn 1983: at most four times the least number of
    pieces). No vertex is added, so pieces meet in whole edges.

    Parameters
    ----------
    polygon
        A valid polygon in metres, holes allowed; repeated and collinear vertices do no harm.

    Returns
    -------
    tuple of (v, 2) arrays
        Corners of each piece, counter-clockwise, not closed, none of them collinear. A convex
        polygon is one piece. Pieces are true to `FLAT_M`.
    """
    outline = _ring(polygon)
    if not polygon.interiors and _is_convex(outline):
        return (_corners(outline),)
    triangles = [
        _ring(shapely.Polygon(triangle.exterior))
        for triangle in shapely.constrained_delaunay_triangles(polygon).geoms
        if isinstance(triangle, shapely.Polygon) and triangle.area > 0
    ]
    return tuple(_corners(ring) for ring in _merged(triangles))


def _ring(polygon: shapely.Polygon) -> list[Vertex]:
    """Exterior vertices, counter-clockwise, not closed, without repetitions in a row."""
    ring = polygon.exterior
    closed = [(float(x), float(y)) for x, y in shapely.get_coordinates(ring)]
    open_ring = [b for a, b in itertools.pairwise(closed) if a != b]
    return open_ring if ring.is_ccw else open_ring[::-1]


def _is_convex_turn(before: Vertex, at: Vertex, after: Vertex) -> bool:
    """Whether `at` turns left, or right by no more than `FLAT_M` from the chord."""
    chord_x, chord_y = after[0] - before[0], after[1] - before[1]
    cross = chord_x * (before[1] - at[1]) - chord_y * (before[0] - at[0])
    return before != after and cross >= -FLAT_M * math.hypot(chord_x, chord_y)


def _is_convex(ring: list[Vertex]) -> bool:
    """Whether the simple counter-clockwise `ring` is convex."""
    return all(_is_convex_turn(ring[i - 2], ring[i - 1], vertex) for i, vertex in enumerate(ring))


def _corners(ring: list[Vertex]) -> NDArray[np.float64]:
    """Corners of the convex hull of `ring`, counter-clockwise: drops flat vertices."""
    hull = shapely.MultiPoint(ring).convex_hull
    if not isinstance(hull, shapely.Polygon):
        raise AssertionError("a piece without area")
    return np.array(_ring(hull))


def _merged(triangles: list[list[Vertex]]) -> list[list[Vertex]]:
    """Merge a conforming triangulation into convex rings, greedily over the longest edges."""
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
    """Directed edges of `ring`, the closing one included."""
    return list(zip(ring, ring[1:] + ring[:1], strict=True))


def _starting_at(ring: list[Vertex], vertex: Vertex) -> list[Vertex]:
    """`ring` rotated so that it starts at `vertex`."""
    start = ring.index(vertex)
    return ring[start:] + ring[:start]
