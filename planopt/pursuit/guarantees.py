"""Guarantees of capture: four theorems, the inequality that each needs, and what it bounds.

A pursuer drives in stages: it takes a record, drives straight to the reported place, and takes the
next record there. W is what bounds the evader's distance at the start of a stage: the distance to
where it was sampled, plus how far it may have moved since. Each theorem bounds the W of the next
stage by this one's, from what the service promises (docs/theory/pursuit.md derives them):

* the Lemma (III.3 of [KAS]) counts the distance to the sampled place alone, which must shrink in
  every stage;
* `any_instant` holds if age and error are bounded by the distance at any one instant between the
  sample and now, whichever it is;
* `sampled_distance` holds if they are bounded by the distance to the sampled place and a record no
  older than the last one is there whenever the pursuer arrives: a faster pursuer can always follow
  the trail;
* `snapshots` holds for the rounds of a snapshot service, waiting for records included.

Among obstacles all four hold with lengths of shortest paths for errors that are wider, or with
straight distances for a pursuer that is slower, by how much longer paths are than straight lines.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.pursuit.service import ServiceBounds, require_number
from planopt.pursuit.theorems import Distances, Inequality, Theorem

Stage = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""From W at the start of a stage to the bound of W at its end and to a duration.

No stage takes longer than its decrease of W times that duration over the decrease to the bound.
"""

INTEGRATION_STEPS = 1000
"""Intervals of the integral that bounds the time to capture, taken from above."""

FLOOR_PLACES, FLOOR_ROUNDS = 65, 11
"""Places among which the floor is looked for, and how often between two of them: to round-off."""


REPORT_SHARE = 2.0
"""A report inside an obstacle stands for the nearest free place, which is at most so many times as
far from where the evader was."""


@dataclass(frozen=True)
class Chase:
    """A pursuer and an evader."""

    evader_speed_m_s: float  # Largest speeds
    pursuer_speed_m_s: float
    # Time that a stage may take beyond straight driving and waiting: turning on the spot, and one
    # step of a control that acts in steps
    stage_delay_s: float = 0.0

    def __post_init__(self) -> None:
        require_number(self.evader_speed_m_s, "evader_speed_m_s", above=0.0)
        require_number(self.pursuer_speed_m_s, "pursuer_speed_m_s", above=0.0)
        require_number(self.stage_delay_s, "stage_delay_s", least=0.0)
        faster = Inequality(
            "evader's speed below the pursuer's",
            self.evader_speed_m_s,
            self.pursuer_speed_m_s,
            "m/s",
        )
        if not faster.holds:
            raise InputError(
                str(faster),
                key="pursuer_speed_m_s",
                remedy="an evader as fast as its pursuer escapes from any service",
            )

    @property
    def speed_ratio(self) -> float:
        """Alpha."""
        return self.pursuer_speed_m_s / self.evader_speed_m_s


@dataclass(frozen=True, eq=False)
class Guarantee:
    """The guarantee of one theorem for a chase."""

    theorem: Theorem  # Which
    chase: Chase
    bounds: ServiceBounds
    inequalities: tuple[Inequality, ...]  # What it needs; it says nothing unless all hold
    ratio: float  # Largest W of a stage over that of the stage before, far from the floor
    floor_m: float  # Below which W need not fall; infinite unless all inequalities hold
    stages: tuple[Stage, ...]
    distances: Distances = Distances.STRAIGHT  # Those that W counts

    @property
    def holds(self) -> bool:
        """Return whether every inequality does."""
        return all(each.holds for each in self.inequalities)

    def next_bound_m(self, bound_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the bound of W at the end of stages that begin with W (...); ``(...)``."""
        return np.max([stage(bound_m)[0] for stage in self.stages], axis=0)

    def start_m(self, distance_m: float) -> float:
        """Return W for a first record of an object sampled so far away."""
        return _start_m(self.chase, self.bounds, distance_m)

    def captures(self, capture_radius_m: float) -> Inequality:
        """Return the inequality that capture within a radius needs beside the theorem's own."""
        return Inequality("floor below the capture radius", self.floor_m, capture_radius_m, "m")

    def capture_time_s(self, distance_m: float, capture_radius_m: float) -> float:
        """Return the longest time until the evader is within the radius; infinite without bound.

        A stage that begins with W takes no longer than its decrease of W times the largest time
        over decrease, which falls with W: the integral of that over W bounds the sum. Without
        floors it is constant, and the bound the W of the start times it.
        """
        require_number(distance_m, "distance_m", least=0.0)
        require_number(capture_radius_m, "capture_radius_m", above=0.0)
        if not self.holds or not self.captures(capture_radius_m).holds:
            return math.inf
        first, last = self._potential(self.start_m(distance_m)), self._potential(capture_radius_m)
        if first <= last:
            return 0.0
        grid = np.geomspace(last, first, INTEGRATION_STEPS + 1)
        pace = np.zeros(INTEGRATION_STEPS)
        for stage in self.stages:
            after, lasts_s = stage(grid[:-1])
            pace = np.maximum(pace, lasts_s / (grid[:-1] - after))
        # The last stage may end anywhere below the radius.
        return float(pace @ np.diff(grid) + pace[0] * last)

    def stage_count(self, distance_m: float, capture_radius_m: float) -> float:
        """Return the most stages until the evader is within the radius; infinite without bound."""
        if not self.holds or not self.captures(capture_radius_m).holds:
            return math.inf
        bound = np.array(self._potential(self.start_m(distance_m)))
        last, count = self._potential(capture_radius_m), 0
        while bound > last:
            bound, count = self.next_bound_m(bound), count + 1
        return count

    def _potential(self, bound_m: float) -> float:
        """Return what stages shrink: W, or the sampled distance of the largest W for the Lemma."""
        if self.theorem is not Theorem.LEMMA:
            return bound_m
        return float(_least_distance_m(self.chase, self.bounds, np.array(bound_m)))


def guarantees(chase: Chase, bounds: ServiceBounds) -> dict[Theorem, Guarantee]:
    """Return what each theorem says about a chase with a service of these bounds."""
    found = [
        _lemma(chase, bounds),
        _any_instant(chase, bounds),
        _sampled_distance(chase, bounds),
    ]
    if bounds.period_s_m is not None:
        found.append(_snapshots(chase, bounds, bounds.period_s_m))
    return {each.theorem: each for each in found}


def guarantees_among_obstacles(
    chase: Chase, bounds: ServiceBounds, detour: float
) -> dict[Distances, dict[Theorem, Guarantee]]:
    """Return what each theorem says where shortest paths are longer than straight lines.

    A service bounds age and error by straight distances. With lengths of paths its ages hold as
    they are, and its errors times the detour factor. With straight distances its errors hold, and
    the pursuer comes nearer as slowly as its speed over the factor. Either will do; the second one
    is missing if the evader is as fast as that.
    """
    require_number(detour, "detour", least=1.0)
    found: dict[Distances, dict[Theorem, Guarantee]] = {}
    ways = {
        Distances.PATHS: (chase.pursuer_speed_m_s, REPORT_SHARE * detour),
        Distances.STRAIGHT: (chase.pursuer_speed_m_s / detour, REPORT_SHARE),
    }
    for distances, (speed_m_s, share) in ways.items():
        if speed_m_s <= chase.evader_speed_m_s:
            continue
        wider = replace(
            bounds,
            relative_error=share * bounds.relative_error,
            error_floor_m=share * bounds.error_floor_m,
        )
        each = guarantees(replace(chase, pursuer_speed_m_s=speed_m_s), wider)
        found[distances] = {
            theorem: replace(guarantee, distances=distances) for theorem, guarantee in each.items()
        }
    return found


def contraction(speed_ratio: float, relative_error: float) -> float:
    """Return a = 1/alpha + kappa (1 + 1/alpha), that is (alpha + k + 1) / (k alpha)."""
    return 1.0 / speed_ratio + relative_error * (1.0 + 1.0 / speed_ratio)


def staleness(chase: Chase, bounds: ServiceBounds) -> float:
    """Return x = sigma v_e: how far an evader moves while a record ages, a metre of distance."""
    return bounds.age_s_m * chase.evader_speed_m_s


def _lemma(chase: Chase, bounds: ServiceBounds) -> Guarantee:
    a, x = contraction(chase.speed_ratio, bounds.relative_error), staleness(chase, bounds)
    needs = (Inequality("a + x below 1", a + x, 1.0),)
    moved_m = chase.evader_speed_m_s * bounds.age_floor_s

    def drive(sampled_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        error_m = _error_m(bounds, sampled_m)
        aged_m = np.maximum(x * sampled_m, moved_m)
        lasts_s = (sampled_m + error_m) / chase.pursuer_speed_m_s + chase.stage_delay_s
        return error_m + aged_m + chase.evader_speed_m_s * lasts_s, lasts_s

    stages = (drive, _wait(chase, bounds, bounds, lag=x))
    sampled_m = _floor_m(needs, stages)
    floor_m = _start_m(chase, bounds, sampled_m) if math.isfinite(sampled_m) else math.inf
    return Guarantee(Theorem.LEMMA, chase, bounds, needs, a + x, floor_m, stages)


def _any_instant(chase: Chase, bounds: ServiceBounds) -> Guarantee:
    a, x = contraction(chase.speed_ratio, bounds.relative_error), staleness(chase, bounds)
    ratio = a + (1.0 - 1.0 / chase.speed_ratio) * x
    needs = (Inequality("a + (1 - 1/alpha) x below 1", ratio, 1.0),)
    moved_m = chase.evader_speed_m_s * bounds.age_floor_s

    def drive(bound_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        sampled_m = np.maximum(0.0, bound_m - np.maximum(x * bound_m, moved_m))
        return _driven(chase, bound_m, sampled_m, _error_m(bounds, bound_m))

    stages = (drive, _wait(chase, bounds, bounds, lag=x))
    return Guarantee(
        Theorem.ANY_INSTANT, chase, bounds, needs, ratio, _floor_m(needs, stages), stages
    )


def _sampled_distance(chase: Chase, bounds: ServiceBounds) -> Guarantee:
    a, x = contraction(chase.speed_ratio, bounds.relative_error), staleness(chase, bounds)
    needs = (Inequality("a below 1", a, 1.0),)
    stages = (_follow(chase, bounds),)
    ratio = (a + x) / (1.0 + x)
    return Guarantee(
        Theorem.SAMPLED_DISTANCE, chase, bounds, needs, ratio, _floor_m(needs, stages), stages
    )


def _snapshots(chase: Chase, bounds: ServiceBounds, period_s_m: float) -> Guarantee:
    """Bounds by the distance to the sampled place follow from those of the rounds.

    A level is used because the next finer one, sampled at most a period later, had the evader
    elsewhere. In between it moved at most y = v_e times that period, so that slopes grow by
    ``1 / (1 - y)``.
    """
    lag = period_s_m * chase.evader_speed_m_s
    needs = [Inequality("y = v_e period below 1", lag, 1.0)]
    if lag >= 1.0:
        return Guarantee(
            Theorem.SNAPSHOTS, chase, bounds, tuple(needs), math.inf, math.inf, (_never,)
        )
    wider = ServiceBounds(
        bounds.age_s_m / (1.0 - lag),
        bounds.relative_error / (1.0 - lag),
        bounds.age_floor_s,
        bounds.error_floor_m,
    )
    a, x = contraction(chase.speed_ratio, wider.relative_error), staleness(chase, wider)
    waits = wider.relative_error * (1.0 + x)
    needs.append(Inequality("a of the error over 1 - y below 1", a, 1.0))
    needs.append(Inequality("growth while waiting below 1", waits, 1.0))
    stages = (_follow(chase, wider), _wait(chase, wider, bounds, lag))
    return Guarantee(
        Theorem.SNAPSHOTS,
        chase,
        bounds,
        tuple(needs),
        max((a + x) / (1.0 + x), waits),
        _floor_m(needs, stages),
        stages,
    )


def _follow(chase: Chase, bounds: ServiceBounds) -> Stage:
    """A stage of driving where the sampled distance bounds age and error."""

    def drive(bound_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        sampled_m = _least_distance_m(chase, bounds, bound_m)
        return _driven(chase, bound_m, sampled_m, _error_m(bounds, sampled_m))

    return drive


def _driven(
    chase: Chase,
    bound_m: NDArray[np.float64],
    sampled_m: NDArray[np.float64],
    error_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """W after a stage, and how long it drives: W grows by the error and what the evader moves.

    Both W and the duration over the decrease are largest where the sampled distance is least.
    """
    lasts_s = (sampled_m + error_m) / chase.pursuer_speed_m_s + chase.stage_delay_s
    return bound_m - sampled_m + error_m + chase.evader_speed_m_s * lasts_s, lasts_s


def _wait(chase: Chase, errors: ServiceBounds, ages: ServiceBounds, lag: float) -> Stage:
    """A stage that ends only when a record fresher than the last one comes.

    Until then all that is there is older, though its age is bounded by a distance that grows no
    faster than the evader moves: the last record is then at most ``sigma error / (1 - lag)`` old.
    """
    if lag >= 1.0:
        return _never

    def wait(bound_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        error_m = _error_m(errors, bound_m)
        oldest_s = np.maximum(ages.age_floor_s, ages.age_s_m / (1.0 - lag) * error_m)
        lasts_s = oldest_s + chase.stage_delay_s
        return error_m + chase.evader_speed_m_s * lasts_s, lasts_s

    return wait


def _never(bound_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.full_like(bound_m, np.inf), np.full_like(bound_m, np.inf)


def _error_m(bounds: ServiceBounds, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.maximum(bounds.relative_error * distance_m, bounds.error_floor_m)


def _start_m(chase: Chase, bounds: ServiceBounds, sampled_m: float) -> float:
    age_s = max(bounds.age_s_m * sampled_m, bounds.age_floor_s)
    return sampled_m + chase.evader_speed_m_s * age_s


def _least_distance_m(
    chase: Chase, bounds: ServiceBounds, bound_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The least sampled distance that goes with W (...): the inverse of :func:`_start_m`."""
    moved_m = chase.evader_speed_m_s * bounds.age_floor_s
    return np.maximum(
        0.0, np.minimum(bound_m / (1.0 + staleness(chase, bounds)), bound_m - moved_m)
    )


def _floor_m(needs: tuple[Inequality, ...] | list[Inequality], stages: tuple[Stage, ...]) -> float:
    """Return where no stage lifts W: the fixed point of a bound that rises less than W."""
    if not all(each.holds for each in needs):
        return math.inf

    def lifts(bounds_m: NDArray[np.float64]) -> NDArray[np.bool_]:
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
