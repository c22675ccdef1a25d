"""How long the ways round obstacles are, at least: a visibility graph from one place on.

Shortest ways lead straight from corner to corner of what is closed to the robot. Obstacles are
grown by a little less than the clearance and with cut corners, so that no way that keeps the
clearance is longer than said, and no place that it reaches is missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.world.clearance import ObstacleIndex, clearance_m, segment_lines

GROWN_SHARE = 0.98
"""Share of the clearance that obstacles are grown by: GEOS is off by up to a hundredth."""

MAX_CORNERS = 600
"""With more corners in reach, ways are as short as the air line: what is said stays true."""


@dataclass(frozen=True, eq=False)
class ShortestWays:
    """Ways from one place, none longer than a radius.

    Attributes
    ----------
    start_m, radius_m
        Where they begin, and how long they may be.
    closed
        What they may not lead through.
    joined
        The part of the workspace that they may lead to; None where nothing is closed.
    corners_m, length_m
        ``(n, 2)`` corners that they turn at, and ``(n,)`` how long the way to each is, ascending.
    """

    start_m: NDArray[np.float64]
    radius_m: float
    closed: shapely.STRtree
    joined: shapely.Geometry | None
    corners_m: NDArray[np.float64]
    length_m: NDArray[np.float64]


def shortest_ways(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    start_m: NDArray[np.float64],
    clearance: float,
    radius_m: float,
) -> ShortestWays:
    """Find the ways from `start_m` (2,) that keep the clearance, up to the radius (both in m)."""
    nothing = ShortestWays(
        start_m, radius_m, shapely.STRtree([]), None, np.zeros((0, 2)), np.zeros(0)
    )
    near = index.tree.query(
        shapely.Point(*start_m), predicate="dwithin", distance=radius_m + clearance
    )
    own = float(clearance_m(index, start_m[None])[0])
    if not len(near) or own == 0.0:
        return nothing
    # A robot that stands nearer than the clearance may do so elsewhere: its ways are not closed.
    closed = _grown(index.polygons[near], GROWN_SHARE * min(clearance, own))
    low, high = np.array(bounds_m[:2]), np.array(bounds_m[2:])
    corners = np.unique(shapely.get_coordinates(closed), axis=0)
    corners = corners[((corners >= low) & (corners <= high)).all(axis=1)]
    corners = corners[_away(corners, start_m) <= radius_m]
    if len(corners) > MAX_CORNERS:
        return nothing
    within = shapely.box(
        *np.maximum(low, start_m - radius_m), *np.minimum(high, start_m + radius_m)
    )
    parts = shapely.get_parts(shapely.difference(within, shapely.union_all(closed)))
    joined = shapely.union_all(parts[shapely.intersects(parts, shapely.Point(*start_m))])
    if joined.is_empty:
        return nothing
    shapely.prepare(joined)
    tree = shapely.STRtree(closed)
    length = _lengths_to_corners(tree, start_m, corners, radius_m)
    order = np.argsort(length)[: int((length <= radius_m).sum())]
    return ShortestWays(start_m, radius_m, tree, joined, corners[order], length[order])


def is_near_joined(
    ways: ShortestWays, places_m: NDArray[np.float64], within_m: float
) -> NDArray[np.bool_]:
    """Whether places (n, 2) are at most so far from what ways may lead to; (n,)."""
    if ways.joined is None:
        return np.ones(len(places_m), dtype=np.bool_)
    points = shapely.points(places_m)
    return np.asarray(shapely.dwithin(ways.joined, points, within_m), dtype=np.bool_)


def way_lengths_m(ways: ShortestWays, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """How long the way to each place (n, 2) is at least; (n,), infinite beyond the radius."""
    length = np.full(len(places_m), np.inf)
    open_ = np.flatnonzero(is_near_joined(ways, places_m, 0.0))
    turns = np.vstack([ways.start_m, ways.corners_m])
    for turn, before in zip(turns, [0.0, *ways.length_m.tolist()], strict=True):
        through = before + _away(places_m[open_], turn)
        shorter = through < np.minimum(length[open_], ways.radius_m * (1.0 + 1e-12))
        tried, through = open_[shorter], through[shorter]
        seen = _sees(ways.closed, turn, places_m[tried])
        length[tried[seen]] = through[seen]
    return length


def _grown(polygons: NDArray[np.object_], by_m: float) -> NDArray[np.object_]:
    """Polygons (n,) grown, their corners cut: nowhere by more than that."""
    if by_m <= 0.0:
        return polygons
    grown = shapely.buffer(polygons, by_m, join_style="bevel")
    return np.asarray(grown, dtype=np.object_)


def _lengths_to_corners(
    closed: shapely.STRtree,
    start_m: NDArray[np.float64],
    corners_m: NDArray[np.float64],
    radius_m: float,
) -> NDArray[np.float64]:
    """Dijkstra's algorithm; what is seen from a corner is only looked at when its turn comes."""
    length = np.full(len(corners_m), np.inf)
    left = np.ones(len(corners_m), dtype=np.bool_)
    here, before = start_m, 0.0
    while True:
        through = before + _away(corners_m, here)
        tried = np.flatnonzero(left & (through < length) & (through <= radius_m))
        seen = tried[_sees(closed, here, corners_m[tried])]
        length[seen] = through[seen]
        waiting = np.where(left, length, np.inf)
        if not len(waiting) or not np.isfinite(waiting.min()):
            return length
        turn = int(waiting.argmin())
        left[turn] = False
        here, before = corners_m[turn], float(length[turn])


def _sees(
    closed: shapely.STRtree, place_m: NDArray[np.float64], others_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the straight way from a place to each other (n, 2) enters nothing closed; (n,)."""
    free = np.ones(len(others_m), dtype=np.bool_)
    if len(others_m) and len(closed.geometries):
        lines = segment_lines(np.broadcast_to(place_m, others_m.shape), others_m)
        for predicate in ("crosses", "within"):
            hit = cast("NDArray[np.intp]", closed.query(lines[free], predicate=predicate))[0]
            free[np.flatnonzero(free)[hit]] = False
    return free


def _away(places_m: NDArray[np.float64], place_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(places_m - place_m, axis=1)
