"""Arenas of a pursuit: open space, a rectangle, or obstacles with shortest paths around them.

Free space is the rectangle minus the obstacles inflated by the clearance. The detour factor is the
largest ratio of shortest path length to straight-line distance.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.world.clearance import ObstacleIndex, clearance_m, index_obstacles, segment_lines
from planopt.world.shortest_paths import (
    MAX_CORNERS,
    ROUND_SHARE,
    ShortestPaths,
    corners_m,
    grown,
    path_lengths_m,
    shortest_paths,
    turns_m,
)
from planopt.world.workspace import Workspace

GOAL_SHARE, EVADER_SHARE = 1.03, 1.06
"""Clearances of moved goals and of evaders as multiples of the path margin. Both exceed it by more
than the errors of GEOS."""
KEPT_PATHS = 64
"""Number of cached start points of shortest paths, enough for all pursuers in a step."""
GOLDEN, NARROWINGS = 0.5 * (math.sqrt(5.0) - 1.0), 34
"""Golden ratio and number of section steps, which narrow an interval by a factor of 1e-7."""


@dataclass(frozen=True)
class Arena:
    """Free space of a pursuit."""

    # (x_min, y_min, x_max, y_max); None for open space
    bounds_m: tuple[float, float, float, float] | None = None
    obstacles: ObstacleIndex | None = None  # None for open space
    clearance_m: float = 0.0  # Obstacle clearance of pursuers and evaders
    # Cached shortest paths by start point
    _kept: dict[tuple[float, float], ShortestPaths] = field(
        default_factory=dict[tuple[float, float], ShortestPaths],
        init=False,
        repr=False,
        compare=False,
    )

    def __post_init__(self) -> None:
        if self.corners > MAX_CORNERS:
            raise InputError(
                f"have {self.corners} corners after inflation by the clearance, more than the "
                f"limit of {MAX_CORNERS}",
                key="obstacles",
                remedy="simplify or remove some of them",
            )

    @property
    def corners(self) -> int:
        """Return the number of vertices at which shortest paths may turn."""
        return 0 if self.obstacles is None else len(corners_m(self._closed))

    @cached_property
    def detour(self) -> float:
        """Return an upper bound on the ratio of shortest path length to straight-line distance."""
        # A straight line leaves free space at one point of a boundary ring and re-enters it at
        # another point of the same ring; the shorter arc of the ring between them is a detour. The
        # bound is exact for isolated convex obstacles.
        if self.obstacles is None or self.bounds_m is None:
            return 1.0
        free = shapely.box(*self.bounds_m).difference(shapely.union_all(self._closed))
        rings = [
            shapely.get_coordinates(ring)[:-1]
            for part in shapely.get_parts(shapely.orient_polygons(free))
            for ring in shapely.get_rings(part)
        ]
        return max((_ring_detour(ring) for ring in rings), default=1.0)

    def moved(self, place_m: Floats, moves_m: Floats) -> Floats:
        """Return the ends (k, 2) of moves from a position (2,), limited by bounds and clearance."""
        # A move that violates the clearance is not made at all.
        ends_m = self.within(place_m + moves_m)
        if self.obstacles is not None:
            lines = segment_lines(np.broadcast_to(place_m, ends_m.shape), ends_m)
            blocked = np.zeros(len(ends_m), dtype=np.bool_)
            hit = self.obstacles.tree.query(
                lines, predicate="dwithin", distance=EVADER_SHARE * self._margin_m
            )[0]
            blocked[hit] = True
            ends_m = np.where(blocked[:, None], place_m, ends_m)
        return ends_m

    def within(self, places_m: Floats) -> Floats:
        """Return the nearest positions (..., 2) within the bounds."""
        if self.bounds_m is None:
            return places_m
        return np.clip(places_m, self.bounds_m[:2], self.bounds_m[2:])

    def route_m(self, place_m: Floats, goal_m: Floats) -> Floats:
        """Return the waypoints (k, 2) of the shortest path to a goal, including the goal."""
        # A goal outside free space is replaced by the nearest free point.
        goal_m = self.free_m(goal_m)
        if self.obstacles is None:
            return goal_m[None]
        turns = turns_m(self._paths(place_m), goal_m)
        if turns is None:
            raise InputError(
                f"no free path leads from {_words(place_m)} to {_words(goal_m)}",
                remedy="start pursuer and evader in the same connected part of the free space",
            )
        return turns

    def distances_m(self, place_m: Floats, goals_m: Floats) -> Floats:
        """Return the lengths (k,) of the shortest paths to goals (k, 2)."""
        if self.obstacles is None:
            return np.linalg.norm(goals_m - place_m, axis=1)
        return path_lengths_m(self._paths(place_m), goals_m)

    def free_m(self, place_m: Floats) -> Floats:
        """Return the free point nearest to a position."""
        place_m = self.within(place_m)
        if self.obstacles is None or self.bounds_m is None or self.is_free(place_m):
            return place_m
        wide = shapely.buffer(self.obstacles.polygons, GOAL_SHARE * self._margin_m)
        free = shapely.box(*self.bounds_m).difference(shapely.union_all(wide))
        # Shapely types the keyword arguments of this function as unknown.
        nearest = shapely.shortest_line(  # pyright: ignore[reportUnknownMemberType]
            shapely.Point(*place_m), free
        )
        return np.asarray(shapely.get_coordinates(nearest)[-1], dtype=np.float64)

    @property
    def _margin_m(self) -> float:
        """Return the distance of path vertices from obstacles, slightly above the clearance."""
        return ROUND_SHARE * self.clearance_m

    def is_free(self, place_m: Floats, share: float = 1.0) -> bool:
        """Return True if a position keeps a clearance of `share` times the path margin."""
        if not np.array_equal(self.within(place_m), place_m):
            return False
        away_m = math.inf
        if self.obstacles is not None:
            away_m = float(clearance_m(self.obstacles, place_m[None])[0])
        return away_m > share * self._margin_m

    @property
    def _closed(self) -> NDArray[np.object_]:
        """Return the obstacles inflated by the path margin."""
        assert self.obstacles is not None
        return grown(self.obstacles.polygons, self._margin_m, inner=False)

    def _paths(self, place_m: Floats) -> ShortestPaths:
        """Return the shortest paths from a position, using a cache of recent ones."""
        kept, key = self._kept, (float(place_m[0]), float(place_m[1]))
        if key in kept:
            return kept[key]
        assert self.obstacles is not None and self.bounds_m is not None
        width_m, height_m = np.subtract(self.bounds_m[2:], self.bounds_m[:2]).tolist()
        # The radius exceeds the length of any shortest path.
        radius_m = 4.0 * (width_m + height_m)
        if len(kept) == KEPT_PATHS:
            del kept[next(iter(kept))]
        kept[key] = shortest_paths(
            self.obstacles, self.bounds_m, place_m, self.clearance_m, radius_m, inner=False
        )
        return kept[key]


def arena_of(workspace: Workspace, clearance_m: float) -> Arena:
    """Return the arena of a workspace, without its moving obstacles."""
    obstacles = index_obstacles(workspace) if workspace.obstacles else None
    return Arena(workspace.bounds_m, obstacles, clearance_m)


def _ring_detour(ring_m: Floats) -> float:
    """Return a ring's largest ratio of shorter arc to chord, for chords on its right-hand side."""
    # For points at s and t on two edges, the arc is a concave function of (s, t) and the chord a
    # convex one, so nested golden-section searches find the largest ratio.
    ahead = np.roll(ring_m, -1, axis=0) - ring_m
    length = np.linalg.norm(ahead, axis=1)
    ring_m, ahead, length = ring_m[length > 0.0], ahead[length > 0.0], length[length > 0.0]
    along = ahead / length[:, None]
    begins = np.append(0.0, np.cumsum(length))
    first, second = np.triu_indices(len(ring_m), 1)
    right = np.stack([along[:, 1], -along[:, 0]], axis=1)
    apart = ring_m[second] - ring_m[first]
    s_range = _positive(
        -_dots(apart, right[second]), _dots(along[first], right[second]), length[first]
    )
    t_range = _positive(
        _dots(apart, right[first]), _dots(along[second], right[first]), length[second]
    )
    kept = (s_range[0] < s_range[1]) & (t_range[0] < t_range[1])
    first, second, apart = first[kept], second[kept], apart[kept]
    if not len(first):
        return 1.0

    def ratio(s: Floats, t: Floats) -> Floats:
        chord = np.linalg.norm(
            apart + t[:, None] * along[second] - s[:, None] * along[first], axis=1
        )
        part = begins[second] + t - begins[first] - s
        return np.minimum(part, begins[-1] - part) / np.maximum(chord, 1e-300)

    def best(s: Floats) -> Floats:
        return _largest(lambda t: ratio(s, t), *t_range[:, kept])

    return max(1.0, float(_largest(best, *s_range[:, kept]).max()))


def _dots(first: Floats, second: Floats) -> Floats:
    return (first * second).sum(axis=1)


def _positive(at_zero: Floats, slope: Floats, end: Floats) -> Floats:
    """Return the subintervals (2, k) of [0, end] where ``at_zero + slope s > 0``."""
    steep = np.abs(slope) > 1e-12
    root = np.clip(-at_zero / np.where(steep, slope, 1.0), 0.0, end)
    low = np.where(steep & (slope > 0.0), root, np.where(~steep & (at_zero <= 0.0), end, 0.0))
    return np.stack([low, np.where(steep & (slope < 0.0), root, end)])


def _largest(function: Callable[[Floats], Floats], low: Floats, high: Floats) -> Floats:
    """Return the maxima (k,) of quasi-concave functions on intervals."""
    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_left, at_right = function(left), function(right)
    for _ in range(NARROWINGS):
        upper = at_left < at_right
        low, high = np.where(upper, left, low), np.where(upper, high, right)
        kept, at_kept = np.where(upper, right, left), np.where(upper, at_right, at_left)
        tried = np.where(upper, low + GOLDEN * (high - low), high - GOLDEN * (high - low))
        at_tried = function(tried)
        left, right = np.where(upper, kept, tried), np.where(upper, tried, kept)
        at_left, at_right = np.where(upper, at_kept, at_tried), np.where(upper, at_tried, at_kept)
    return np.maximum(at_left, at_right)


def _words(place_m: Floats) -> str:
    return f"({place_m[0]:.6g}, {place_m[1]:.6g})"
