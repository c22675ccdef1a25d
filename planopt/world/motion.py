"""Curves and motions of robots: clearance from obstacles, and separation of two motions in time.

A curve is the path of one step, with time from 0 to 1; a motion consists of several steps. With the
bound ``|p''| <= c``, the position is within ``c d^2 / 8`` of uniform motion along a chord of
duration d. Discs are predicted moving obstacles and other robots; a disc grows with the uncertainty
of its prediction (equation 6.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import shapely

from planopt.arrays import Floats, Mask
from planopt.world.clearance import ObstacleIndex, clearance_m, containing_obstacle
from planopt.world.workspace import MovingObstacle

WHOLE_STEP = np.array([0.0, 1.0])  # Start and end time of a curve


SAG_M = 5e-7  # Maximum distance in metres between a curve and the polyline that approximates it


class StepCurve(Protocol):
    """Protocol of the path of one step, as a function of time and as a set of points."""

    @property
    def breaks(self) -> Floats:
        """Times (k,) from 0 to 1 between which the curve is smooth."""
        ...

    @property
    def curving_m(self) -> float:
        """Bound in metres on the second time derivative of :meth:`at` between the breaks."""
        ...

    @property
    def within_m(self) -> float:
        """Largest distance of the robot from the position :meth:`at`."""
        ...

    def at(self, share: Floats) -> Floats:
        """Return positions (k, 2) at times (k,)."""
        ...

    def points_m(self) -> tuple[Floats, float]:
        """Return a polyline (k, 2), and the largest distance of the curve from the polyline."""
        ...

    def clearance_m(self, index: ObstacleIndex) -> float:
        """Return the distance to the nearest obstacle, or a lower bound; inf without obstacles."""
        ...


@dataclass(frozen=True, eq=False)
class PointCurve:
    """Polyline with a bound on the robot's distance from the polyline."""

    places_m: Floats  # (k, 2) points, k >= 1; evenly spaced in time for a timed curve
    # Largest distance from the polyline; for a timed curve, from uniform motion on it
    within_m: float

    curving_m = 0.0  # Straight between the points

    @property
    def breaks(self) -> Floats:
        """Times of the points."""
        return np.linspace(0.0, 1.0, len(self.places_m))

    def at(self, share: Floats) -> Floats:
        """Return interpolated positions at times `share` (k,)."""
        x, y = (np.interp(share, self.breaks, self.places_m[:, axis]) for axis in (0, 1))
        return np.stack([x, y], axis=1)

    def points_m(self) -> tuple[Floats, float]:
        """Return the polyline, and the bound on the robot's distance from the polyline."""
        return self.places_m, self.within_m

    def clearance_m(self, index: ObstacleIndex) -> float:
        """Return a lower bound of the distance to the nearest obstacle."""
        return max(0.0, _polyline_m(index, self.places_m) - self.within_m)


@dataclass(frozen=True, eq=False)
class Parabola:
    """Parabola p(t) = start + t along + t^2 bend for t from 0 to 1."""

    start_m: Floats  # (2,) each
    along_m: Floats
    bend_m: Floats

    breaks = WHOLE_STEP
    within_m = 0.0

    @property
    def curving_m(self) -> float:
        """Magnitude in metres of the constant second derivative with respect to t."""
        return 2.0 * float(np.hypot(*self.bend_m))

    def at(self, share: Floats) -> Floats:
        """Return the positions p(t) at times `share` (k,)."""
        t = share[:, None]
        return self.start_m + t * self.along_m + t * t * self.bend_m

    def points_m(self) -> tuple[Floats, float]:
        """Return a polyline of n pieces whose error is at most |bend| / (4 n^2)."""
        bend = float(np.hypot(*self.bend_m))
        count = max(1, math.ceil(math.sqrt(bend / (4.0 * SAG_M))))
        return self.at(np.linspace(0.0, 1.0, count + 1)), bend / (4.0 * count * count)

    def clearance_m(self, index: ObstacleIndex) -> float:
        """Return a lower bound of the clearance, with an error of at most a micrometre."""
        places, within = self.points_m()
        return max(0.0, _polyline_m(index, places) - within)


def even_motion(ends_m: Floats) -> Parabola:
    """Return the uniform motion between two positions (2, 2) as a curve."""
    return Parabola(ends_m[0], ends_m[1] - ends_m[0], np.zeros(2))


@dataclass(frozen=True, eq=False)
class Arc:
    """Circular arc driven at constant speed; a straight segment if `turn_rad` is 0."""

    start_m: Floats  # (2,)
    heading_rad: float  # Direction of the tangent at the start
    length_m: float  # Negative in reverse
    turn_rad: float  # Turn of the tangent from start to end

    breaks = WHOLE_STEP
    within_m = 0.0

    @property
    def bulge_m(self) -> float:
        """Upper bound of the distance between the arc's middle and the chord."""
        return self.curving_m / 8.0

    @property
    def curving_m(self) -> float:
        """Magnitude in metres of the second derivative w.r.t. time (0 to 1 over a step)."""
        return abs(self.length_m * self.turn_rad)

    def points_m(self) -> tuple[Floats, float]:
        """Return a polyline of n pieces whose error is at most |length turn| / (8 n^2)."""
        count = max(1, math.ceil(math.sqrt(self.bulge_m / SAG_M)))
        return self.at(np.linspace(0.0, 1.0, count + 1)), self.bulge_m / (count * count)

    def clearance_m(self, index: ObstacleIndex) -> float:
        """Return the exact clearance, or a lower bound for nearly straight arcs."""
        ends = self.at(np.array([0.0, 0.25, 0.5, 0.75, 1.0]))
        if self.bulge_m <= 1e-9:
            return max(0.0, _polyline_m(index, ends[[0, -1]]) - self.bulge_m)
        if not index.obstacles:
            return math.inf
        if containing_obstacle(index, self.start_m) is not None:
            return 0.0
        at_most = float(clearance_m(index, ends).min())
        # The nearest obstacle is within this distance of the polyline through `ends`.
        reach = at_most + 2.0 * self.bulge_m
        near = index.tree.query(shapely.LineString(ends), predicate="dwithin", distance=reach)
        edges = [_edges(polygon) for polygon in index.polygons[near]]
        starts, stops = (np.concatenate([edge[end] for edge in edges]) for end in (0, 1))
        distances = arc_segment_distances_m(
            self.start_m, self.heading_rad, self.length_m, self.turn_rad, starts, stops
        )
        return float(distances.min())

    def at(self, share: Floats) -> Floats:
        """Return positions (k, 2) at times `share` (k,)."""
        half = 0.5 * share * self.turn_rad
        # numpy.sinc(x) is sin(pi x) / (pi x).
        chord = share * self.length_m * np.sinc(half / math.pi)
        direction = self.heading_rad + half
        offsets = np.column_stack([chord * np.cos(direction), chord * np.sin(direction)])
        return self.start_m + offsets


def _polyline_m(index: ObstacleIndex, places_m: Floats) -> float:
    """Return the distance of a polyline (k, 2) to the nearest obstacle."""
    if not index.obstacles:
        return math.inf
    moved = np.concatenate([[True], (np.diff(places_m, axis=0) ** 2).sum(axis=1) > 0.0])
    places = places_m[moved]
    shape = shapely.Point(places[0]) if len(places) == 1 else shapely.LineString(places)
    _, distance = index.tree.query_nearest(shape, return_distance=True, all_matches=False)
    return float(distance.min())


def _edges(polygon: shapely.Polygon) -> tuple[Floats, Floats]:
    """Return the start and end points of all edges, including edges of holes."""
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(polygon)]
    return (
        np.concatenate([ring[:-1] for ring in rings]),
        np.concatenate([ring[1:] for ring in rings]),
    )


def arc_segment_distances_m(
    start_m: Floats,  # (2,) start of the arc
    heading_rad: float,
    length_m: float,
    turn_rad: float,
    from_m: Floats,
    to_m: Floats,
) -> Floats:
    """Return the distance (n,) of an arc to each of n segments."""
    # The nearest points are a crossing, an end of the arc or the segment, or the foot of the
    # perpendicular from the centre to the segment, if the ray through it meets the arc.
    # Shapes: from_m, to_m (n, 2).
    signed = length_m / turn_rad
    radius = abs(signed)
    centre = start_m + signed * np.array([-math.sin(heading_rad), math.cos(heading_rad)])
    first = math.atan2(start_m[1] - centre[1], start_m[0] - centre[0])

    def on_arc(angles: Floats) -> Mask:
        """Return a mask of the directions, seen from the arc's centre, that meet the arc."""
        gone = (angles - first) if turn_rad > 0.0 else (first - angles)
        return np.mod(gone, 2.0 * math.pi) <= abs(turn_rad)

    last = first + turn_rad
    end = centre + radius * np.array([math.cos(last), math.sin(last)])
    along = to_m - from_m
    square = np.maximum((along**2).sum(axis=1), np.finfo(np.float64).tiny)

    def foot(place: Floats) -> tuple[Floats, Floats]:
        """Return the parameter of the perpendicular's foot on each line, and the distance."""
        t = ((place - from_m) * along).sum(axis=1) / square
        near = from_m + np.clip(t, 0.0, 1.0)[:, None] * along
        return t, np.linalg.norm(place - near, axis=1)

    def radial(places: Floats) -> Floats:
        """Return the radial distance of `places` to the arc; inf outside its sector."""
        offset = places - centre
        away = np.abs(np.hypot(offset[:, 0], offset[:, 1]) - radius)
        return np.where(on_arc(np.arctan2(offset[:, 1], offset[:, 0])), away, math.inf)

    t, _ = foot(centre)
    feet = from_m + t[:, None] * along
    inside = (t >= 0.0) & (t <= 1.0)
    best = np.minimum.reduce([foot(start_m)[1], foot(end)[1], radial(from_m), radial(to_m)])
    best = np.where(inside, np.minimum(best, radial(feet)), best)
    # Crossings lie half a chord on either side of the feet.
    apart = ((feet - centre) ** 2).sum(axis=1)
    half = np.sqrt(np.maximum(radius * radius - apart, 0.0) / square)
    for side in (-half, half):
        crossing = from_m + (t + side)[:, None] * along
        offset = crossing - centre
        hit = (apart <= radius * radius) & (t + side >= 0.0) & (t + side <= 1.0)
        hit &= on_arc(np.arctan2(offset[:, 1], offset[:, 0]))
        best = np.where(hit, 0.0, best)
    return best


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """Motion over n steps, followed by rest."""

    places_m: Floats  # (n + 1, 2) positions now and after each step
    curves: tuple[StepCurve, ...] = ()  # One per step; empty if all are straight and uniform

    @property
    def steps(self) -> int:
        """Number of steps n."""
        return len(self.places_m) - 1

    def curve(self, step: int) -> StepCurve:
        """Return the curve of step `step`, counted from 0; at rest after the last step."""
        if step >= self.steps:
            return even_motion(self.places_m[-1:].repeat(2, axis=0))
        return self.curves[step] if self.curves else even_motion(self.places_m[step : step + 2])

    def lasting(self, steps: int) -> TimedMotion:
        """Return the motion truncated or extended by rest to `steps` steps."""
        places = self.places_m[np.minimum(np.arange(steps + 1), self.steps)]
        return TimedMotion(places, tuple(map(self.curve, range(steps))) if self.curves else ())

    def after(self, steps: int) -> TimedMotion:
        """Return the motion after the first `steps` steps."""
        return TimedMotion(self.places_m[steps:], self.curves[steps:])

    @property
    def bulges_m(self) -> Floats:
        """Bound (n,) on the distance of each step from uniform motion along the step's chord."""
        if not self.curves:
            return np.zeros(self.steps)
        found: list[float] = []
        for curve, begin, move in zip(
            self.curves, self.places_m[:-1], np.diff(self.places_m, axis=0), strict=True
        ):
            off = curve.at(curve.breaks) - begin - curve.breaks[:, None] * move
            bent = curve.curving_m * float(np.diff(curve.breaks).max()) ** 2 / 8.0
            found.append(float(np.linalg.norm(off, axis=1).max()) + bent + curve.within_m)
        return np.array(found)


def closest_approach_m(
    first_starts_m: Floats, first_ends_m: Floats, second_starts_m: Floats, second_ends_m: Floats
) -> Floats:
    """Return the minimum distance between two points in uniform straight motion during a step."""
    # Relative to the second point, the first moves straight from r to r + d. The minimum distance
    # is ``|r + t d|`` at time ``t = clip(-r . d / d . d, 0, 1)``.
    # Shapes: first_starts_m, first_ends_m, second_starts_m, second_ends_m (..., 2).
    return np.asarray(
        np.linalg.norm(
            nearest_to_origin_m(first_starts_m - second_starts_m, first_ends_m - second_ends_m),
            axis=-1,
        )
    )


def nearest_to_origin_m(starts_m: Floats, ends_m: Floats) -> Floats:
    """Return the point (..., 2) on each segment nearest to the origin of coordinates."""
    along = ends_m - starts_m
    square = (along * along).sum(axis=-1)
    share = -(starts_m * along).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    share = np.clip(np.where(square > 0.0, share, 0.0), 0.0, 1.0)
    # Measured from the nearer end, so that ends are reproduced exactly.
    late = share[..., None] > 0.5
    return np.where(
        late, ends_m - (1.0 - share[..., None]) * along, starts_m + share[..., None] * along
    )


CLOSE_M = 1e-7  # Tolerance of computed minimum distances in metres, a tenth of the verifier's
CLOSE_SHARE = 1e-9
"""Tolerance of minimum distances as a share of the curvature bound, for curves of kilometres."""


def curve_distance_m(first: StepCurve, second: StepCurve, at_most_m: float = math.inf) -> float:
    """Return a lower bound of the distance of two curves at equal times, tight to `CLOSE_M`."""
    unknown = first.within_m + second.within_m
    curving = first.curving_m + second.curving_m
    if not math.isfinite(curving + unknown):
        return 0.0
    close = max(CLOSE_M, CLOSE_SHARE * curving)
    breaks = np.union1d(first.breaks, second.breaks)
    begin, end = breaks[:-1], breaks[1:]
    least, settled = at_most_m + unknown, math.inf
    while len(begin):
        chord = closest_approach_m(first.at(begin), first.at(end), second.at(begin), second.at(end))
        off = curving * (end - begin) ** 2 / 8.0
        least = min(least, float((chord + off).min()))
        lower = chord - off
        open_ = lower < least - close
        settled = min(settled, float(lower[~open_].min(initial=math.inf)))
        begin, end = begin[open_], end[open_]
        middle = 0.5 * (begin + end)
        begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
    return max(0.0, settled - unknown)


def step_distances_m(first: TimedMotion, second: TimedMotion, steps: int) -> Floats:
    """Return tight lower bounds (steps,) on the distance between two motions in each step."""
    # Each motion is at rest after its own last step.
    one, other = first.lasting(steps), second.lasting(steps)
    if not one.curves and not other.curves:
        return chord_distances_m(one, other)
    return np.array([curve_distance_m(one.curve(k), other.curve(k)) for k in range(steps)])


def chord_distances_m(first: TimedMotion, second: TimedMotion) -> Floats:
    """Return the minimum distances (n,) of two motions, taken as uniform along their chords."""
    a, b = first.places_m, second.places_m
    return closest_approach_m(a[:-1], a[1:], b[:-1], b[1:])


def least_gap(first: TimedMotion, second: TimedMotion, taken_m: Floats) -> tuple[float, int]:
    """Return the minimum over n steps of distance minus `taken_m` (n,), and its step index."""
    # Steps are evaluated in the order of their lower bounds.
    steps = len(taken_m)
    one, other = first.lasting(steps), second.lasting(steps)
    gaps = chord_distances_m(one, other) - taken_m
    if not one.curves and not other.curves:
        return float(gaps.min()), int(gaps.argmin())
    lower = gaps - one.bulges_m - other.bulges_m
    best, at = math.inf, 0
    for k in np.argsort(lower, kind="stable").tolist():
        if lower[k] >= best:
            break
        taken = float(taken_m[k])
        gap = curve_distance_m(one.curve(k), other.curve(k), best + taken) - taken
        if gap < best:
            best, at = gap, k
    return best, at


@dataclass(frozen=True, eq=False)
class MovingDiscs:
    """Predicted motion of m discs over the next T steps, braking steps included."""

    names: tuple[str, ...]  # Names in messages
    centres_m: Floats  # (m, T + 1, 2) now and after each step
    radius_m: Floats  # (m, T) during each step
    least_m: Floats  # (m,) required distance of a robot from the disc
    is_robot: Mask  # (m,) True for other robots, which are points
    # (m,) curves of the T steps of each disc; empty if straight at constant speed
    curves: tuple[tuple[StepCurve, ...], ...] = ()
    bulges_m: Floats = field(init=False)  # (m, T) distance from straight uniform motion

    def __post_init__(self) -> None:
        bulges = [self.motion(number).bulges_m for number in range(len(self))]
        object.__setattr__(self, "bulges_m", np.reshape(bulges, self.radius_m.shape))

    def __len__(self) -> int:
        """Return the number of discs, m."""
        return len(self.names)

    @property
    def apart_m(self) -> Floats:
        """Required distance (m, T) of a robot from each centre in each step."""
        return self.radius_m + self.least_m[:, None] + self.bulges_m

    @property
    def steps(self) -> int:
        """Number of steps T."""
        return int(self.radius_m.shape[1])

    def counted_steps(self, number: int, motion: TimedMotion) -> int:
        """Return the number of steps during which a motion must avoid disc `number`."""
        # Other robots count until all are at rest, moving obstacles until this robot is at rest.
        return self.steps if self.is_robot[number] else min(motion.steps, self.steps)

    def motion(self, number: int) -> TimedMotion:
        """Return the motion of disc `number`."""
        return TimedMotion(self.centres_m[number], self.curves[number] if self.curves else ())


NOTHING_MOVES = MovingDiscs(
    (), np.zeros((0, 1, 2)), np.zeros((0, 0)), np.zeros(0), np.zeros(0, dtype=np.bool_)
)
"""Empty set of discs."""


def joined_discs(first: MovingDiscs, second: MovingDiscs) -> MovingDiscs:
    """Return the union of two sets of discs over the same number of steps."""
    if not len(first) or not len(second):
        return first if len(first) else second
    curves = [discs.curves or ((),) * len(discs) for discs in (first, second)]
    return MovingDiscs(
        (*first.names, *second.names),
        np.concatenate([first.centres_m, second.centres_m]),
        np.concatenate([first.radius_m, second.radius_m]),
        np.concatenate([first.least_m, second.least_m]),
        np.concatenate([first.is_robot, second.is_robot]),
        (*curves[0], *curves[1]),
    )


def passing_gaps_m(discs: MovingDiscs, step: int, starts_m: Floats, ends_m: Floats) -> Floats:
    """Return distances to discs minus required ones (m, ...), for straight motions in `step`."""
    # Shapes: starts_m, ends_m (..., 2).
    shape = (len(discs), *([1] * (starts_m.ndim - 1)), 2)
    before = discs.centres_m[:, step].reshape(shape)
    after = discs.centres_m[:, step + 1].reshape(shape)
    near = closest_approach_m(starts_m, ends_m, before, after)
    return near - discs.apart_m[:, step].reshape(shape[:-1])


def path_distances_m(discs: MovingDiscs, path_m: Floats) -> Floats:
    """Return the distance (m, N) of a path (N + 1, 2) from each centre during each step."""
    # Path and centres are assumed to move straight at constant speed within a step.
    centres = discs.centres_m[:, : len(path_m)]
    return closest_approach_m(path_m[:-1], path_m[1:], centres[:, :-1], centres[:, 1:])


def paths_gap_m(discs: MovingDiscs, paths_m: Floats) -> Floats:
    """Return the smallest separation margin along each of c paths; infinite without discs."""
    # Shapes: paths_m (c, N + 1, 2).
    if not len(discs):
        return np.full(len(paths_m), np.inf)
    places = int(paths_m.shape[1])
    centres = discs.centres_m[:, :places]
    near = closest_approach_m(
        paths_m[:, None, :-1], paths_m[:, None, 1:], centres[:, :-1], centres[:, 1:]
    )
    return (near - discs.apart_m[:, : places - 1]).min(axis=(1, 2))


def centres_at(obstacle: MovingObstacle, times_s: Floats) -> Floats:
    """Return the predicted centre (n, 2) of an obstacle at each of n times."""
    known = np.asarray(obstacle.times_s)
    places = np.asarray(obstacle.positions_m)
    after = np.maximum(times_s - known[-1], 0.0)
    return np.stack(
        [
            np.interp(times_s, known, places[:, axis]) + after * obstacle.velocity_m_s[axis]
            for axis in (0, 1)
        ],
        axis=1,
    )


def growth_m(obstacle: MovingObstacle, ahead_s: Floats) -> Floats:
    """Return the radius growth (n,) due to the uncertainty of predictions `ahead_s` ahead."""
    deviation = np.hypot(obstacle.position_std_m, 0.5 * obstacle.acceleration_std_m_s2 * ahead_s**2)
    return deviation * math.sqrt(-2.0 * math.log((1.0 - obstacle.probability) / 2.0))


def predicted_discs(
    obstacles: tuple[MovingObstacle, ...],
    now_s: float,
    step_s: float,
    steps: int,
    clearance_m: float,
) -> MovingDiscs:
    """Return the predicted discs of moving obstacles over the next steps."""
    # A turn of a path within a step enlarges the radius by its distance from the line.
    times = now_s + step_s * np.arange(steps + 1, dtype=np.float64)
    centres = np.array([centres_at(obstacle, times) for obstacle in obstacles])
    radius = np.array(
        [
            obstacle.radius_m + _turn_m(obstacle, times) + growth_m(obstacle, times[1:] - now_s)
            for obstacle in obstacles
        ]
    )
    return MovingDiscs(
        tuple(obstacle.name for obstacle in obstacles),
        centres.reshape(-1, steps + 1, 2),
        radius.reshape(-1, steps),
        np.full(len(obstacles), clearance_m),
        np.zeros(len(obstacles), dtype=np.bool_),
    )


def _turn_m(obstacle: MovingObstacle, times_s: Floats) -> Floats:
    """Return each step's largest distance (n - 1,) of the centre from the chord of the step."""
    # Both are linear between turns, so the distance is largest at a turn.
    known = np.asarray(obstacle.times_s)
    turns = known[(known > times_s[0]) & (known < times_s[-1])]
    step = np.searchsorted(times_s, turns, side="right") - 1
    ends = centres_at(obstacle, times_s)
    share = ((turns - times_s[step]) / (times_s[step + 1] - times_s[step]))[:, None]
    chord = (1.0 - share) * ends[step] + share * ends[step + 1]
    farthest = np.zeros(len(times_s) - 1)
    away = np.linalg.norm(centres_at(obstacle, turns) - chord, axis=1)
    # A turn at the end of a step differs from the chord only by rounding.
    np.maximum.at(farthest, step, np.where(away > 1e-12, away, 0.0))
    return farthest
