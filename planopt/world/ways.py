"""Curved ways of one step: their distance to the obstacles, and how far they reach.

Straight ways and arcs are exact; a parabola's distance is a bound from below that is less than a
micrometre off; any other way is given by points that it is within a known distance of. Ways also
say when the robot is where: see :mod:`planopt.world.timed_motion`.

Exact distance between a circular arc and straight segments.

The nearest two points of an arc and a segment are a crossing, or an end of either, or where the
segment's foot from the centre is seen along a ray that meets the arc.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.world.clearance import ObstacleIndex, clearance_m, containing_obstacle
from planopt.world.timed_motion import WHOLE_STEP, TimedWay


def arc_segment_distances_m(
    start_m: NDArray[np.float64],  # (2,) where the arc begins
    heading_rad: float,
    length_m: float,
    turn_rad: float,
    from_m: NDArray[np.float64],
    to_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Distance of an arc from each of n segments; (n,)."""
    # Shapes: from_m, to_m (n, 2).
    signed = length_m / turn_rad
    radius = abs(signed)
    centre = start_m + signed * np.array([-math.sin(heading_rad), math.cos(heading_rad)])
    first = math.atan2(start_m[1] - centre[1], start_m[0] - centre[0])

    def on_arc(angles: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether the arc passes through these directions from its centre."""
        gone = (angles - first) if turn_rad > 0.0 else (first - angles)
        return np.mod(gone, 2.0 * math.pi) <= abs(turn_rad)

    last = first + turn_rad
    end = centre + radius * np.array([math.cos(last), math.sin(last)])
    along = to_m - from_m
    square = np.maximum((along**2).sum(axis=1), np.finfo(np.float64).tiny)

    def foot(place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the foot of a place on each segment's line, and its distance."""
        t = ((place - from_m) * along).sum(axis=1) / square
        near = from_m + np.clip(t, 0.0, 1.0)[:, None] * along
        return t, np.linalg.norm(place - near, axis=1)

    def radial(places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance to the arc along the ray from its centre; infinite where that misses it."""
        offset = places - centre
        away = np.abs(np.hypot(offset[:, 0], offset[:, 1]) - radius)
        return np.where(on_arc(np.arctan2(offset[:, 1], offset[:, 0])), away, math.inf)

    t, _ = foot(centre)
    feet = from_m + t[:, None] * along
    inside = (t >= 0.0) & (t <= 1.0)
    best = np.minimum.reduce([foot(start_m)[1], foot(end)[1], radial(from_m), radial(to_m)])
    best = np.where(inside, np.minimum(best, radial(feet)), best)
    # Crossings: at the feet, half a chord to either side.
    apart = ((feet - centre) ** 2).sum(axis=1)
    half = np.sqrt(np.maximum(radius * radius - apart, 0.0) / square)
    for side in (-half, half):
        crossing = from_m + (t + side)[:, None] * along
        offset = crossing - centre
        hit = (apart <= radius * radius) & (t + side >= 0.0) & (t + side <= 1.0)
        hit &= on_arc(np.arctan2(offset[:, 1], offset[:, 0]))
        best = np.where(hit, 0.0, best)
    return best


SAG_M = 5e-7
"""Curves are given by points so near to each other that straight lines between them are off by no
more than this, where that is not exact."""


class Way(Protocol):
    """The way of one step."""

    def points_m(self) -> tuple[NDArray[np.float64], float]:
        """Points (k, 2) of the way in order, and how far it is from the lines between them."""
        ...

    def clearance_m(self, index: ObstacleIndex) -> float:
        """Distance to the nearest obstacle, or a bound below; infinite without obstacles."""
        ...


class StepWay(Way, TimedWay, Protocol):
    """A way that a robot takes in one step."""


@dataclass(frozen=True, eq=False)
class PointWay:
    """A way of which only points are known."""

    # (k, 2), k at least 1; of a timed way at equal times, from begin to end
    places_m: NDArray[np.float64]
    # The way is nowhere farther than this from the straight lines between them; of a timed way,
    # from even motion on them
    within_m: float

    @property
    def breaks(self) -> NDArray[np.float64]:
        """The times of its points."""
        return np.linspace(0.0, 1.0, len(self.places_m))

    @property
    def curving_m(self) -> float:
        """It is straight between them."""
        return 0.0

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places on the lines between them."""
        x, y = (np.interp(share, self.breaks, self.places_m[:, axis]) for axis in (0, 1))
        return np.stack([x, y], axis=1)

    def points_m(self) -> tuple[NDArray[np.float64], float]:
        """Its points."""
        return self.places_m, self.within_m

    def clearance_m(self, index: ObstacleIndex) -> float:
        """A bound below."""
        return max(0.0, _polyline_m(index, self.places_m) - self.within_m)


@dataclass(frozen=True, eq=False)
class Parabola:
    """p(t) = start + t along + t^2 bend for t from 0 to 1."""

    start_m: NDArray[np.float64]  # (2,) each
    along_m: NDArray[np.float64]
    bend_m: NDArray[np.float64]

    @property
    def breaks(self) -> NDArray[np.float64]:
        """It is smooth."""
        return WHOLE_STEP

    @property
    def curving_m(self) -> float:
        """Its second derivative, which is constant."""
        return 2.0 * float(np.hypot(*self.bend_m))

    @property
    def within_m(self) -> float:
        """It is exact."""
        return 0.0

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places by the formula."""
        t = share[:, None]
        return self.start_m + t * self.along_m + t * t * self.bend_m

    def points_m(self) -> tuple[NDArray[np.float64], float]:
        """Points whose lines are off by at most |bend| / (4 n^2)."""
        bend = float(np.hypot(*self.bend_m))
        count = max(1, math.ceil(math.sqrt(bend / (4.0 * SAG_M))))
        t = np.linspace(0.0, 1.0, count + 1)[:, None]
        places = self.start_m + t * self.along_m + t * t * self.bend_m
        return places, bend / (4.0 * count * count)

    def clearance_m(self, index: ObstacleIndex) -> float:
        """A bound below, less than a micrometre off."""
        places, within = self.points_m()
        return max(0.0, _polyline_m(index, places) - within)


@dataclass(frozen=True, eq=False)
class Arc:
    """A circular arc, a straight line where it does not turn."""

    start_m: NDArray[np.float64]  # (2,)
    heading_rad: float  # Direction of the tangent at the start
    length_m: float  # Negative where it is driven backward
    turn_rad: float  # By how much the tangent turns from start to end

    @property
    def bulge_m(self) -> float:
        """Return about how far the middle is from the chord, a bound above."""
        return self.curving_m / 8.0

    @property
    def breaks(self) -> NDArray[np.float64]:
        """It is smooth."""
        return WHOLE_STEP

    @property
    def curving_m(self) -> float:
        """Its second derivative, towards the centre: speed is constant."""
        return abs(self.length_m * self.turn_rad)

    @property
    def within_m(self) -> float:
        """It is exact."""
        return 0.0

    def points_m(self) -> tuple[NDArray[np.float64], float]:
        """Points whose lines are off by at most length turn / (8 n^2)."""
        count = max(1, math.ceil(math.sqrt(self.bulge_m / SAG_M)))
        return self.at(np.linspace(0.0, 1.0, count + 1)), self.bulge_m / (count * count)

    def clearance_m(self, index: ObstacleIndex) -> float:
        """Exact, but for arcs as straight as round-off."""
        ends = self.at(np.array([0.0, 0.25, 0.5, 0.75, 1.0]))
        if self.bulge_m <= 1e-9:
            return max(0.0, _polyline_m(index, ends[[0, -1]]) - self.bulge_m)
        if not index.obstacles:
            return math.inf
        if containing_obstacle(index, self.start_m) is not None:
            return 0.0
        at_most = float(clearance_m(index, ends).min())
        # The nearest obstacle is no farther from the lines between these than this.
        reach = at_most + 2.0 * self.bulge_m
        near = index.tree.query(shapely.LineString(ends), predicate="dwithin", distance=reach)
        edges = [_edges(polygon) for polygon in index.polygons[near]]
        starts, stops = (np.concatenate([edge[end] for edge in edges]) for end in (0, 1))
        distances = arc_segment_distances_m(
            self.start_m, self.heading_rad, self.length_m, self.turn_rad, starts, stops
        )
        return float(distances.min())

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places (k, 2) at shares (k,) of the arc."""
        half = 0.5 * share * self.turn_rad
        # NumPy's sinc is that of pi times its argument.
        chord = share * self.length_m * np.sinc(half / math.pi)
        direction = self.heading_rad + half
        offsets = np.column_stack([chord * np.cos(direction), chord * np.sin(direction)])
        return self.start_m + offsets


def _polyline_m(index: ObstacleIndex, places_m: NDArray[np.float64]) -> float:
    """Distance of the lines through places (k, 2) to the nearest obstacle."""
    if not index.obstacles:
        return math.inf
    moved = np.concatenate([[True], (np.diff(places_m, axis=0) ** 2).sum(axis=1) > 0.0])
    places = places_m[moved]
    shape = shapely.Point(places[0]) if len(places) == 1 else shapely.LineString(places)
    _, distance = index.tree.query_nearest(shape, return_distance=True, all_matches=False)
    return float(distance.min())


def _edges(polygon: shapely.Polygon) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts and ends of all edges, those of holes included."""
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(polygon)]
    return (
        np.concatenate([ring[:-1] for ring in rings]),
        np.concatenate([ring[1:] for ring in rings]),
    )
