"""Shortest ways round obstacles from one place: a visibility graph, looked at as it is needed.

Shortest ways lead straight from corner to corner of what is closed to the robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.world.clearance import ObstacleIndex, clearance_m, segment_lines

INNER_SHARE = 0.98
"""Share of the clearance that obstacles are grown by for a bound below: GEOS is off by up to a
hundredth."""

QUARTER_SEGMENTS = 2
"""Straight pieces of a quarter of a turn about a corner, for ways that can be driven."""

ROUND_SHARE = 1.0 / math.cos(0.25 * math.pi / QUARTER_SEGMENTS)
"""Their ends are so much farther from the corner than their middles, which keep the clearance."""

MAX_CORNERS = 600
"""With more corners in reach, ways are as short as the air line: what is said stays true."""


@dataclass(frozen=True, eq=False)
class ShortestPaths:
    """Ways from one place, none longer than a radius."""

    start_m: NDArray[np.float64]  # Where they begin, and how long they may be
    radius_m: float
    closed: shapely.STRtree  # What they may not lead through
    # The part of the workspace that they may lead to; None where nothing is closed
    joined: shapely.Geometry | None
    # (n, 2) corners that they turn at, (n,) how long the way to each is, ascending, and which
    # corner it comes from last, -1 for the start
    corners_m: NDArray[np.float64]
    length_m: NDArray[np.float64]
    before: NDArray[np.intp]


def shortest_paths(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    start_m: NDArray[np.float64],
    clearance: float,
    radius_m: float,
    inner: bool,
) -> ShortestPaths:
    """Find the ways from `start_m` (2,) that keep the clearance, up to the radius (both in m).

    With `inner` obstacles are grown by a little less, their corners cut: no way that keeps the
    clearance is shorter than said, and no place that it leads to is missed.
    """
    nothing = ShortestPaths(
        start_m,
        radius_m,
        shapely.STRtree([]),
        None,
        np.zeros((0, 2)),
        np.zeros(0),
        np.zeros(0, dtype=np.intp),
    )
    near = index.tree.query(
        shapely.Point(*start_m), predicate="dwithin", distance=radius_m + clearance
    )
    own = float(clearance_m(index, start_m[None])[0])
    if not len(near) or own == 0.0:
        return nothing
    # A robot that stands nearer than the clearance may do so elsewhere: its ways are not closed.
    by = min(clearance, own) * INNER_SHARE if inner else min(clearance * ROUND_SHARE, own)
    closed = grown(index.polygons[near], by, inner)
    low, high = np.array(bounds_m[:2]), np.array(bounds_m[2:])
    corners = np.unique(corners_m(closed), axis=0)
    corners = corners[((corners >= low) & (corners <= high)).all(axis=1)]
    corners = corners[_away(corners, start_m) <= radius_m]
    if len(corners) > MAX_CORNERS:
        return nothing
    x_min, y_min = np.maximum(low, start_m - radius_m).tolist()
    x_max, y_max = np.minimum(high, start_m + radius_m).tolist()
    within = shapely.Polygon([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)])
    parts = shapely.get_parts(within.difference(shapely.union_all(closed)))
    joined = shapely.union_all(parts[shapely.intersects(parts, shapely.Point(*start_m))])
    if joined.is_empty:
        return nothing
    shapely.prepare(joined)
    tree = shapely.STRtree(closed)
    length, before = _lengths_to_corners(tree, start_m, corners, radius_m)
    order = np.argsort(length, kind="stable")[: int((length <= radius_m).sum())]
    # A way comes from a corner that is nearer, which is in the order too.
    place = np.full(len(corners) + 1, -1, dtype=np.intp)
    place[order] = np.arange(len(order))
    return ShortestPaths(
        start_m, radius_m, tree, joined, corners[order], length[order], place[before[order]]
    )


def is_near_joined(
    ways: ShortestPaths, places_m: NDArray[np.float64], within_m: float
) -> NDArray[np.bool_]:
    """Return whether places (n, 2) are at most so far from what ways may lead to; (n,)."""
    if ways.joined is None:
        return np.ones(len(places_m), dtype=np.bool_)
    points = shapely.points(places_m)
    return np.asarray(shapely.dwithin(ways.joined, points, within_m), dtype=np.bool_)


def path_lengths_m(ways: ShortestPaths, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the length of the way to each place (n, 2); (n,), infinite beyond the radius."""
    return _last_turns(ways, places_m)[0]


def turns_m(ways: ShortestPaths, place_m: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return turns of the way to a place (2,), (k, 2), the place itself last; None if none."""
    length, last = _last_turns(ways, place_m[None])
    if not np.isfinite(length[0]):
        return None
    turns, corner = [place_m], int(last[0])
    while corner >= 0:
        turns.append(ways.corners_m[corner])
        corner = int(ways.before[corner])
    return np.array(turns[::-1])


def _last_turns(
    ways: ShortestPaths, places_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return each place's (n, 2) length of way, and its last corner, -1 if it is straight."""
    length, last = np.full(len(places_m), np.inf), np.full(len(places_m), -1, dtype=np.intp)
    open_ = np.flatnonzero(is_near_joined(ways, places_m, 0.0))
    for corner in range(-1, len(ways.corners_m)):
        turn, before = ways.start_m, 0.0
        if corner >= 0:
            turn, before = ways.corners_m[corner], float(ways.length_m[corner])
        through = before + _away(places_m[open_], turn)
        shorter = (through < length[open_]) & (through <= ways.radius_m)
        tried, through = open_[shorter], through[shorter]
        seen = _sees(ways.closed, turn, places_m[tried])
        length[tried[seen]] = through[seen]
        last[tried[seen]] = corner
    return length, last


def grown(polygons: NDArray[np.object_], by_m: float, inner: bool) -> NDArray[np.object_]:
    """Return polygons (n,) grown by so many metres; `inner` ones nowhere by more than that."""
    if by_m <= 0.0:
        return polygons
    if inner:
        grown = shapely.buffer(polygons, by_m, join_style="bevel")
    else:
        grown = shapely.buffer(polygons, by_m, quad_segs=QUARTER_SEGMENTS)
    return np.asarray(grown, dtype=np.object_)


def corners_m(polygons: NDArray[np.object_], free: bool = False) -> NDArray[np.float64]:
    """Return the corners (n, 2) at which shortest paths turn: they stand out into free space.

    Polygons are obstacles, or free space itself.
    """
    found = [np.zeros((0, 2))]
    for part in shapely.get_parts(polygons):
        for number, ring in enumerate(shapely.get_rings(part)):
            places = shapely.get_coordinates(ring)[:-1]
            here = places - places[0]
            before = places - np.roll(places, 1, axis=0)
            after = np.roll(before, -1, axis=0)
            turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
            # The outer ring comes first; what is free lies inside the others.
            ahead = np.roll(here, -1, axis=0)
            area = float((here[:, 0] * ahead[:, 1] - here[:, 1] * ahead[:, 0]).sum())
            outward = (area > 0.0) == (number == 0)
            found.append(places[turn > 0.0 if outward != free else turn < 0.0])
    return np.concatenate(found)


def _lengths_to_corners(
    closed: shapely.STRtree,
    start_m: NDArray[np.float64],
    corners_m: NDArray[np.float64],
    radius_m: float,
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Dijkstra's algorithm; what is seen from a corner is only looked at when its turn comes."""
    length = np.full(len(corners_m), np.inf)
    before = np.full(len(corners_m), -1, dtype=np.intp)
    left = np.ones(len(corners_m), dtype=np.bool_)
    turn, here, driven = -1, start_m, 0.0
    while True:
        through = driven + _away(corners_m, here)
        tried = np.flatnonzero(left & (through < length) & (through <= radius_m))
        seen = tried[_sees(closed, here, corners_m[tried])]
        length[seen], before[seen] = through[seen], turn
        waiting = np.where(left, length, np.inf)
        if not len(waiting) or not np.isfinite(waiting.min()):
            return length, before
        turn = int(waiting.argmin())
        left[turn] = False
        here, driven = corners_m[turn], float(length[turn])


def _sees(
    closed: shapely.STRtree, place_m: NDArray[np.float64], others_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return whether straight ways from a place to others (n, 2) enter nothing closed; (n,)."""
    free = np.ones(len(others_m), dtype=np.bool_)
    if len(others_m) and len(closed.geometries):
        lines = segment_lines(np.broadcast_to(place_m, others_m.shape), others_m)
        for predicate in ("crosses", "within"):
            hit = cast("NDArray[np.intp]", closed.query(lines[free], predicate=predicate))[0]
            free[np.flatnonzero(free)[hit]] = False
    return free


def _away(places_m: NDArray[np.float64], place_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(places_m - place_m, axis=1)
