"""Guarantees of capture: four theorems, their required inequalities, and their bounds.

A pursuer drives in stages: it takes a record, drives straight to the reported position, and takes
the next record there. W bounds the evader's distance at the start of a stage: the distance to its
sampled position plus its possible displacement since then. Each theorem bounds the W of the next
stage by the W of the current one, using the bounds of the service (docs/theory/pursuit.md):

* the Lemma (III.3 of [KAS]) bounds the distance to the sampled position, which must shrink in
  every stage;
* `any_instant` holds if age and error are bounded by the distance at some instant between the
  sample and now;
* `sampled_distance` holds if they are bounded by the distance to the sampled position and the
  pursuer always finds a record no older than its last one on arrival: a faster pursuer can
  always follow the trail;
* `snapshots` holds for the rounds of a snapshot service, including the wait for records; it bounds
  every stage by the levels that the service may use (`planopt.pursuit.levels`).

Among obstacles all four hold either for shortest path lengths with larger errors, or for straight
distances with a pursuer slowed by the detour factor.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.pursuit.certificate import Distances, Inequality, Theorem
from planopt.pursuit.levels import LevelBounds
from planopt.pursuit.service import ServiceBounds

Stage = Callable[[Floats], tuple[Floats, Floats]]
"""Function that maps the bound W at the start of a stage to the bound W' at its end and a time T.

A stage that reduces W by D lasts at most T D / (W - W').
"""
INTEGRATION_STEPS = 1000
"""Number of intervals of the integral that bounds the capture time from above."""
FLOOR_PLACES, FLOOR_ROUNDS = 65, 11
"""Grid points and number of grid refinements of the search for the floor."""
REPORT_SHARE = 2.0
"""Maximum factor on a report's error if the report is moved to the nearest free point."""


@dataclass(frozen=True)
class Chase:
    """Speeds of a pursuer and an evader, and the pursuer's delay per stage."""

    evader_speed_m_s: float  # Maximum speeds
    pursuer_speed_m_s: float
    # Maximum time of a stage in addition to straight driving and waiting: a turn on the spot, and
    # one step of a discrete-time controller
    stage_delay_s: float = 0.0

    @property
    def slower_evader(self) -> Inequality:
        """Return the inequality that every theorem requires: evader slower than pursuer."""
        return Inequality(
            "evader's speed below the pursuer's",
            self.evader_speed_m_s,
            self.pursuer_speed_m_s,
            "m/s",
        )

    @property
    def speed_ratio(self) -> float:
        """Return the ratio of the pursuer's speed to the evader's speed."""
        return self.pursuer_speed_m_s / self.evader_speed_m_s


@dataclass(frozen=True, eq=False)
class Guarantee:
    """Guarantee of one theorem for a chase."""

    theorem: Theorem
    chase: Chase
    bounds: ServiceBounds
    inequalities: tuple[Inequality, ...]  # Required inequalities
    ratio: float  # Maximum ratio of successive W, far from the floor
    stages: tuple[Stage, ...]
    distances: Distances = Distances.STRAIGHT  # Kind of distance bounded by W
    levels: LevelBounds | None = None  # Bounds by level, for snapshots whose inequalities hold

    @property
    def holds(self) -> bool:
        """Return whether every inequality holds."""
        return all(each.holds for each in self.inequalities)

    @cached_property
    def floor_m(self) -> float:
        """Return the largest bound without guaranteed decrease; infinite if an inequality fails."""
        if self.levels is not None:
            return self.levels.floor_m() if self.holds else math.inf
        floor_m = _floor_m(self.stages) if self.holds else math.inf
        if self.theorem is Theorem.LEMMA and math.isfinite(floor_m):
            return _start_m(self.chase, self.bounds, floor_m)
        return floor_m

    def next_bound_m(self, bound_m: Floats) -> Floats:
        """Return the distance bounds after a stage, for the distance bounds before the stage."""
        if self.levels is not None:
            return self.levels.next_bound_m(bound_m)
        return np.max([stage(bound_m)[0] for stage in self.stages], axis=0)

    def captures(self, capture_radius_m: float) -> Inequality:
        """Return the additional inequality required for capture within a radius."""
        return Inequality("floor below the capture radius", self.floor_m, capture_radius_m, "m")

    def capture_time_s(self, distance_m: float, capture_radius_m: float) -> float:
        """Return the maximum time until the evader is within the radius; infinite if unbounded."""
        # A stage starting with W takes at most its decrease of W times the maximum ratio of time to
        # decrease. This ratio falls with W, so its integral over W bounds the total time.
        if not self.holds or not self.captures(capture_radius_m).holds:
            return math.inf
        if self.levels is not None:
            reach_m = self.bounds.reach_m
            if reach_m is not None and self.levels.start_m(distance_m) > reach_m:
                return math.inf
            return self.levels.capture_time_s(distance_m, capture_radius_m)
        first, last = _start_m(self.chase, self.bounds, distance_m), capture_radius_m
        if self.theorem is Theorem.LEMMA:  # Bounds the sampled distance
            least = _least_distance_m(self.chase, self.bounds, np.array([first, last]))
            first, last = least.tolist()
        if first <= last:
            return 0.0
        grid = np.geomspace(last, first, INTEGRATION_STEPS + 1)
        pace = np.zeros(INTEGRATION_STEPS)
        for stage in self.stages:
            after, lasts_s = stage(grid[:-1])
            pace = np.maximum(pace, lasts_s / (grid[:-1] - after))
        # The last stage may end anywhere below the radius.
        return float(pace @ np.diff(grid) + pace[0] * last)


def capture_guarantees(chase: Chase, bounds: ServiceBounds) -> dict[Theorem, Guarantee]:
    """Return the guarantee of each theorem for a chase, given the bounds of the service."""
    if not chase.slower_evader.holds:
        needs = (chase.slower_evader,)
        return {
            theorem: Guarantee(theorem, chase, bounds, needs, math.inf, (_never,))
            for theorem in Theorem
            if theorem is not Theorem.SNAPSHOTS or bounds.spacing_m is not None
        }
    a, x = contraction(chase.speed_ratio, bounds.relative_error), staleness(chase, bounds)
    moved_m = chase.evader_speed_m_s * bounds.age_floor_s
    wait = _wait(chase, bounds)

    def shrink(sampled_m: Floats) -> tuple[Floats, Floats]:
        """Return Lemma III.3's bound on the next sampled distance, and the stage's duration."""
        error_m, aged_m = _error_m(bounds, sampled_m), np.maximum(x * sampled_m, moved_m)
        lasts_s = (sampled_m + error_m) / chase.pursuer_speed_m_s + chase.stage_delay_s
        return error_m + aged_m + chase.evader_speed_m_s * lasts_s, lasts_s

    def drive(bound_m: Floats) -> tuple[Floats, Floats]:
        sampled_m = np.maximum(0.0, bound_m - np.maximum(x * bound_m, moved_m))
        return _driven(chase, bound_m, sampled_m, _error_m(bounds, bound_m))

    def follow(bound_m: Floats) -> tuple[Floats, Floats]:
        """Return the bound after a drive, and its duration; the sampled distance bounds both."""
        sampled_m = _least_distance_m(chase, bounds, bound_m)
        return _driven(chase, bound_m, sampled_m, _error_m(bounds, sampled_m))

    ratio = a + (1.0 - 1.0 / chase.speed_ratio) * x
    lemma = Inequality("a + x below 1", a + x, 1.0)
    instant = Inequality("a + (1 - 1/alpha) x below 1", ratio, 1.0)
    sampled, rest = Inequality("a below 1", a, 1.0), (a + x) / (1.0 + x)
    each = [
        Guarantee(Theorem.LEMMA, chase, bounds, (lemma,), a + x, (shrink, wait)),
        Guarantee(Theorem.ANY_INSTANT, chase, bounds, (instant,), ratio, (drive, wait)),
        Guarantee(Theorem.SAMPLED_DISTANCE, chase, bounds, (sampled,), rest, (follow,)),
    ]
    if bounds.period_s_m is not None and bounds.spacing_m is not None:
        each.append(_by_snapshots(chase, bounds, bounds.period_s_m, bounds.spacing_m))
    return {one.theorem: one for one in each}


def _by_snapshots(
    chase: Chase, bounds: ServiceBounds, period_s_m: float, spacing_m: float
) -> Guarantee:
    """Return the guarantee for nested snapshot rounds, whose period grows with the distance."""
    # A level is used because the next finer one, sampled at most a period later, placed the evader
    # elsewhere. Between both samples it moved at most y = v_e times the period.
    lag, x = period_s_m * chase.evader_speed_m_s, staleness(chase, bounds)
    late = Inequality("y = v_e period below 1", lag, 1.0)
    if not late.holds:
        return Guarantee(Theorem.SNAPSHOTS, chase, bounds, (late,), math.inf, (_never,))
    error, moved = bounds.relative_error / (1.0 - lag), x / (1.0 - lag)
    a, waits = contraction(chase.speed_ratio, error), error * (1.0 + moved)
    period_s = 0.5 * period_s_m * spacing_m
    levels = LevelBounds(
        chase.evader_speed_m_s,
        chase.pursuer_speed_m_s,
        chase.stage_delay_s,
        spacing_m,
        bounds.age_floor_s - period_s,
        period_s,
        bounds.relative_error,
        bounds.error_floor_m,
    )
    needs = (
        late,
        Inequality("a of the error over 1 - y below 1", a, 1.0),
        Inequality("growth while waiting below 1", waits, 1.0),
    )
    ratio = max((a + moved) / (1.0 + moved), waits)
    return Guarantee(Theorem.SNAPSHOTS, chase, bounds, needs, ratio, (), levels=levels)


def guarantees_among_obstacles(
    chase: Chase, bounds: ServiceBounds, detour: float
) -> dict[Distances, dict[Theorem, Guarantee]]:
    """Return the guarantees among obstacles, for shortest paths and for straight distances."""
    # The bounds of a service refer to straight distances. For path lengths, ages are unchanged and
    # errors grow by the detour factor. For straight distances, errors are unchanged and the
    # pursuer's speed is divided by the factor; this case is omitted if the evader is not slower.
    found: dict[Distances, dict[Theorem, Guarantee]] = {}
    for distances, speed_m_s, share in (
        (Distances.PATHS, chase.pursuer_speed_m_s, REPORT_SHARE * detour),
        (Distances.STRAIGHT, chase.pursuer_speed_m_s / detour, REPORT_SHARE),
    ):
        if distances is Distances.STRAIGHT and speed_m_s <= chase.evader_speed_m_s:
            continue
        wider = replace(
            bounds,
            relative_error=share * bounds.relative_error,
            error_floor_m=share * bounds.error_floor_m,
        )
        each = capture_guarantees(replace(chase, pursuer_speed_m_s=speed_m_s), wider)
        found[distances] = {
            theorem: replace(
                guarantee,
                distances=distances,
                levels=guarantee.levels and replace(guarantee.levels, open_space=False),
            )
            for theorem, guarantee in each.items()
        }
    return found


def contraction(speed_ratio: float, relative_error: float) -> float:
    """Return the contraction per stage, for the speed ratio and the relative error of records."""
    return 1.0 / speed_ratio + relative_error * (1.0 + 1.0 / speed_ratio)


def staleness(chase: Chase, bounds: ServiceBounds) -> float:
    """Return the evader displacement during a record's age, per metre of distance."""
    return bounds.age_s_m * chase.evader_speed_m_s


def _driven(
    chase: Chase, bound_m: Floats, sampled_m: Floats, error_m: Floats
) -> tuple[Floats, Floats]:
    """Return the distance bound after a driving stage, and the duration of the stage."""
    lasts_s = (sampled_m + error_m) / chase.pursuer_speed_m_s + chase.stage_delay_s
    return bound_m - sampled_m + error_m + chase.evader_speed_m_s * lasts_s, lasts_s


def _wait(chase: Chase, bounds: ServiceBounds) -> Stage:
    """Return a waiting stage, which ends when a fresher record arrives."""
    # Until then all records are older, but their age is bounded by a distance that grows no faster
    # than the evader moves: the last record is at most ``sigma error / (1 - x)`` old.
    x = staleness(chase, bounds)
    if x >= 1.0:
        return _never

    def wait(bound_m: Floats) -> tuple[Floats, Floats]:
        error_m = _error_m(bounds, bound_m)
        oldest_s = np.maximum(bounds.age_floor_s, bounds.age_s_m / (1.0 - x) * error_m)
        lasts_s = oldest_s + chase.stage_delay_s
        return error_m + chase.evader_speed_m_s * lasts_s, lasts_s

    return wait


def _never(bound_m: Floats) -> tuple[Floats, Floats]:
    return np.full_like(bound_m, np.inf), np.full_like(bound_m, np.inf)


def _error_m(bounds: ServiceBounds, distance_m: Floats) -> Floats:
    return np.maximum(bounds.relative_error * distance_m, bounds.error_floor_m)


def _start_m(chase: Chase, bounds: ServiceBounds, sampled_m: float) -> float:
    """Return the distance bound at the first record, from the evader's sampled distance."""
    age_s = max(bounds.age_s_m * sampled_m, bounds.age_floor_s)
    return sampled_m + chase.evader_speed_m_s * age_s


def _least_distance_m(chase: Chase, bounds: ServiceBounds, bound_m: Floats) -> Floats:
    """Return the sampled distances at which :func:`_start_m` equals `bound_m`, at least 0."""
    moved_m = chase.evader_speed_m_s * bounds.age_floor_s
    return np.maximum(
        0.0, np.minimum(bound_m / (1.0 + staleness(chase, bounds)), bound_m - moved_m)
    )


def _floor_m(stages: tuple[Stage, ...]) -> float:
    """Return the largest distance bound that a stage may increase."""

    def lifts(bounds_m: Floats) -> Mask:
        return np.any([stage(bounds_m)[0] > bounds_m for stage in stages], axis=0)

    if not lifts(np.zeros(1))[0]:
        return 0.0
    grid = np.asarray(np.append(0.0, np.exp2(np.arange(-1020.0, 1000.0))), dtype=np.float64)
    for _ in range(FLOOR_ROUNDS):
        last = int(np.flatnonzero(lifts(grid))[-1])
        if last + 1 == len(grid):
            return math.inf
        grid = np.linspace(float(grid[last]), float(grid[last + 1]), FLOOR_PLACES)
    return float(grid[-1])
