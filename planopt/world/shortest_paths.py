"""Shortest paths around obstacles, made of straight segments between corners."""

import math
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from planopt.arrays import Floats, Indices, Mask
from planopt.world.clearance import ObstacleIndex, clearance_m, segment_lines

INNER_SHARE = 0.98  # Share of the clearance by which obstacles are inflated for lower bounds
QUARTER_SEGMENTS = 2  # Number of segments per quarter circle around a corner, for drivable paths
ROUND_SHARE = 1.0 / math.cos(0.25 * math.pi / QUARTER_SEGMENTS)
"""Ratio of the radii of segment ends and midpoints. The midpoints are at the clearance."""
MAX_CORNERS = 600
"""Maximum number of corners. For more corners, straight-line distances serve as lower bounds."""


@dataclass(frozen=True, eq=False)
class ShortestPaths:
    """Shortest paths from one position up to a maximum length."""

    start_m: Floats  # (2,)
    radius_m: float  # Maximum path length
    closed: shapely.STRtree  # Inflated obstacles
    joined: shapely.Geometry | None  # Connected component of free space; None without obstacles
    # (n, 2) corners, (n,) ascending path lengths, (n,) previous corners (-1: start)
    corners_m: Floats
    length_m: Floats
    before: Indices


def shortest_paths(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    start_m: Floats,
    clearance: float,
    radius_m: float,
    inner: bool,
) -> ShortestPaths:
    """Return the shortest paths from `start_m` (2,) with a clearance, up to length `radius_m`."""
    # With `inner`, lengths are lower bounds, and every reachable position is found.
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
    # A start closer than the clearance reduces the clearance, so that paths from it exist.
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
    # The previous corner is nearer and thus also in `order`.
    place = np.full(len(corners) + 1, -1, dtype=np.intp)
    place[order] = np.arange(len(order))
    return ShortestPaths(
        start_m, radius_m, tree, joined, corners[order], length[order], place[before[order]]
    )


def is_near_joined(paths: ShortestPaths, places_m: Floats, within_m: float) -> Mask:
    """Return a mask of positions (n, 2) within `within_m` of free space connected to the start."""
    if paths.joined is None:
        return np.ones(len(places_m), dtype=np.bool_)
    points = shapely.points(places_m)
    return np.asarray(shapely.dwithin(paths.joined, points, within_m), dtype=np.bool_)


def path_lengths_m(paths: ShortestPaths, places_m: Floats) -> Floats:
    """Return the shortest path length (n,) to each position, infinite beyond the radius."""
    return _last_turns(paths, places_m)[0]


def turns_m(paths: ShortestPaths, place_m: Floats) -> Floats | None:
    """Return the turns and the end (k, 2) of the path to `place_m`; None if there is none."""
    length, last = _last_turns(paths, place_m[None])
    if not np.isfinite(length[0]):
        return None
    turns, corner = [place_m], int(last[0])
    while corner >= 0:
        turns.append(paths.corners_m[corner])
        corner = int(paths.before[corner])
    return np.array(turns[::-1])


def _last_turns(paths: ShortestPaths, places_m: Floats) -> tuple[Floats, Indices]:
    """Return the path length to each position (n, 2), and the last corner's index or -1."""
    length, last = np.full(len(places_m), np.inf), np.full(len(places_m), -1, dtype=np.intp)
    open_ = np.flatnonzero(is_near_joined(paths, places_m, 0.0))
    for corner in range(-1, len(paths.corners_m)):
        turn, before = paths.start_m, 0.0
        if corner >= 0:
            turn, before = paths.corners_m[corner], float(paths.length_m[corner])
        through = before + _away(places_m[open_], turn)
        shorter = (through < length[open_]) & (through <= paths.radius_m)
        nearer, through = open_[shorter], through[shorter]
        seen = _sees(paths.closed, turn, places_m[nearer])
        length[nearer[seen]] = through[seen]
        last[nearer[seen]] = corner
    return length, last


def grown(polygons: NDArray[np.object_], by_m: float, inner: bool) -> NDArray[np.object_]:
    """Return polygons (n,) inflated by `by_m`; with `inner`, corners are bevelled."""
    if by_m <= 0.0:
        return polygons
    if inner:
        grown = shapely.buffer(polygons, by_m, join_style="bevel")
    else:
        grown = shapely.buffer(polygons, by_m, quad_segs=QUARTER_SEGMENTS)
    return np.asarray(grown, dtype=np.object_)


def corners_m(polygons: NDArray[np.object_], free: bool = False) -> Floats:
    """Return the corners (n, 2) at which shortest paths turn, i.e. convex obstacle corners."""
    # The polygons are obstacles, or free space if `free` is set.
    found = [np.zeros((0, 2))]
    for part in shapely.get_parts(polygons):
        for number, ring in enumerate(shapely.get_rings(part)):
            places = shapely.get_coordinates(ring)[:-1]
            here = places - places[0]
            before = places - np.roll(places, 1, axis=0)
            after = np.roll(before, -1, axis=0)
            turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
            # The outer ring comes first; the other rings enclose holes.
            ahead = np.roll(here, -1, axis=0)
            area = float((here[:, 0] * ahead[:, 1] - here[:, 1] * ahead[:, 0]).sum())
            outward = (area > 0.0) == (number == 0)
            found.append(places[turn > 0.0 if outward != free else turn < 0.0])
    return np.concatenate(found)


def _lengths_to_corners(
    closed: shapely.STRtree, start_m: Floats, corners_m: Floats, radius_m: float
) -> tuple[Floats, Indices]:
    """Return path lengths to corners, and the index of the corner before each (-1: none)."""
    length = np.full(len(corners_m), np.inf)
    before = np.full(len(corners_m), -1, dtype=np.intp)
    left = np.ones(len(corners_m), dtype=np.bool_)
    turn, here, driven = -1, start_m, 0.0
    while True:
        through = driven + _away(corners_m, here)
        nearer = np.flatnonzero(left & (through < length) & (through <= radius_m))
        seen = nearer[_sees(closed, here, corners_m[nearer])]
        length[seen], before[seen] = through[seen], turn
        waiting = np.where(left, length, np.inf)
        if not len(waiting) or not np.isfinite(waiting.min()):
            return length, before
        turn = int(waiting.argmin())
        left[turn] = False
        here, driven = corners_m[turn], float(length[turn])


def _sees(closed: shapely.STRtree, place_m: Floats, others_m: Floats) -> Mask:
    """Return a mask of segments from `place_m` to `others_m` (n, 2) that avoid obstacles."""
    free = np.ones(len(others_m), dtype=np.bool_)
    if len(others_m) and len(closed.geometries):
        lines = segment_lines(np.broadcast_to(place_m, others_m.shape), others_m)
        for predicate in ("crosses", "within"):
            hit = cast("Indices", closed.query(lines[free], predicate=predicate))[0]
            free[np.flatnonzero(free)[hit]] = False
    return free


def _away(places_m: Floats, place_m: Floats) -> Floats:
    return np.linalg.norm(places_m - place_m, axis=1)


SLACK = 1e-9  # Rounding tolerance of positions outside an area, as a share of its extent


@dataclass(frozen=True, eq=False)
class FreeArea:
    """Area with the shortest paths between all its corners, created by :func:`free_area`."""

    polygon: shapely.Polygon  # Allowed positions
    slack_m: float  # Distance outside up to which a position still counts as on the boundary
    # Boundary moved outward by more than `slack_m`, which no allowed line intersects
    border: shapely.Geometry
    corners_m: Floats  # (c, 2) corners at which shortest paths may turn
    between_m: Floats  # (c, c) shortest distances between them

    def allows(self, places_m: Floats) -> Mask:
        """Return a mask (k,) of the positions (k, 2) that are inside the area."""
        points = shapely.points(places_m)
        return np.asarray(shapely.dwithin(self.polygon, points, self.slack_m), dtype=np.bool_)

    def nearest(self, places_m: Floats) -> Floats:
        """Return the points of the area nearest to positions (k, 2)."""
        moved, out = np.array(places_m, dtype=np.float64), ~self.allows(places_m)
        moved[out] = nearest_places(self.polygon, moved[out])
        return moved

    def sees(self, starts_m: Floats, ends_m: Floats) -> Mask:
        """Return a mask (k,) of the lines between allowed positions that stay in the area."""
        lines = segment_lines(starts_m, ends_m)
        return ~np.asarray(shapely.intersects(self.border, lines), dtype=np.bool_)

    def sees_each(self, places_m: Floats, others_m: Floats) -> Mask:
        """Return a mask (k, l) of mutually visible allowed positions (k, 2) and (l, 2)."""
        count, other = len(places_m), len(others_m)
        starts, ends = np.repeat(places_m, other, axis=0), np.tile(others_m, (count, 1))
        return self.sees(starts, ends).reshape(count, other)

    def to_corners_m(self, starts_m: Floats) -> tuple[Floats, Indices]:
        """Return path lengths (n, c) from positions to corners, and indices of first corners."""
        # Lengths are infinite for a position that sees no corner.
        away = np.linalg.norm(starts_m[:, None] - self.corners_m, axis=2)
        away[~self.sees_each(starts_m, self.corners_m)] = np.inf
        length, first = np.empty(away.shape), np.zeros(away.shape, dtype=np.intp)
        if not len(self.corners_m):
            return length, first
        for row, own in enumerate(away):
            through = own[:, None] + self.between_m
            length[row] = through.min(axis=0)
            # A path that starts at a corner heads for the next one.
            at = own <= self.slack_m
            if at.any() and not at.all():
                through[at] += self.slack_m
            first[row] = through.argmin(axis=0)
        return length, first

    def last_legs_m(self, ends_m: Floats, sees: Mask) -> Floats:
        """Return distances (k, c) from `ends_m` to corners; infinite for hidden corners."""
        legs = np.linalg.norm(ends_m[:, None] - self.corners_m, axis=2)
        legs[~sees] = np.inf
        return legs

    def distances_m(self, starts_m: Floats, ends_m: Floats) -> Floats:
        """Return the lengths (n, k) of shortest paths between allowed positions."""
        found = np.linalg.norm(starts_m[:, None] - ends_m, axis=2)
        found[~self.sees_each(starts_m, ends_m)] = np.inf
        last = self.last_legs_m(ends_m, self.sees_each(ends_m, self.corners_m))
        for length, leg in zip(self.to_corners_m(starts_m)[0].T, last.T, strict=True):
            found = np.minimum(found, length[:, None] + leg)
        return found

    def first_turns_m(self, starts_m: Floats, ends_m: Floats) -> tuple[Floats, Floats]:
        """Return the ends (k, 2) of the first legs of shortest paths, and path lengths (k,)."""
        length, turn = np.linalg.norm(ends_m - starts_m, axis=1), ends_m.copy()
        blind = np.flatnonzero(~self.sees(starts_m, ends_m))
        if len(blind) and len(self.corners_m):
            reach, first = self.to_corners_m(starts_m[blind])
            sees = self.sees_each(ends_m[blind], self.corners_m)
            through = reach + self.last_legs_m(ends_m[blind], sees)
            best, own = through.argmin(axis=1), np.arange(len(blind))
            length[blind] = through[own, best]
            turn[blind] = self.corners_m[first[own, best]]
        return turn, length


def free_area(polygon: shapely.Polygon) -> FreeArea:
    """Return the area of a polygon with holes, with shortest paths between its corners."""
    slack = SLACK * float(np.ptp(np.asarray(polygon.bounds).reshape(2, 2), axis=0).max())
    border = shapely.boundary(shapely.buffer(polygon, 2.0 * slack, join_style="mitre"))
    shapely.prepare(polygon)
    shapely.prepare(border)
    corners = np.unique(corners_m(np.array([polygon]), free=True), axis=0)
    straight = np.linalg.norm(corners[:, None] - corners, axis=2)
    area = FreeArea(polygon, slack, border, corners, straight)
    straight[~area.sees_each(corners, corners)] = 0.0
    between = np.asarray(dijkstra(straight), dtype=np.float64) if len(corners) else straight
    return replace(area, between_m=between)


def nearest_places(area: shapely.Polygon, places_m: Floats) -> Floats:
    """Return the points of an area nearest to positions (k, 2)."""
    links = shapely.shortest_line(area, shapely.points(places_m))  # pyright: ignore[reportUnknownMemberType]
    return np.asarray(shapely.get_coordinates(links), dtype=np.float64)[::2]
