"""Motions over time: the paths of several steps, and least distances between two of them.

Within a step times are shares of it. A path bounds its curvature, ``|p''| <= c`` by share, so that
between two times that are d apart the position is nowhere farther than ``c d^2 / 8`` from even
motion on the straight line between the positions at both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

WHOLE_STEP = np.array([0.0, 1.0])
"""Times at which a way begins and ends."""


class TimedWay(Protocol):
    """The way of one step of which it is known when the robot is where."""

    @property
    def breaks(self) -> NDArray[np.float64]:
        """Times (k,) from 0 to 1 between which it is smooth."""
        ...

    @property
    def curving_m(self) -> float:
        """Bound on the second derivative of :meth:`at` between them."""
        ...

    @property
    def within_m(self) -> float:
        """Return how far from :meth:`at` the robot may be."""
        ...

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places (k, 2) at times (k,)."""
        ...


@dataclass(frozen=True, eq=False)
class EvenWay:
    """Straight and even."""

    ends_m: NDArray[np.float64]  # (2, 2) where it begins and ends

    @property
    def breaks(self) -> NDArray[np.float64]:
        """It is smooth."""
        return WHOLE_STEP

    @property
    def curving_m(self) -> float:
        """Nothing."""
        return 0.0

    @property
    def within_m(self) -> float:
        """It is exact."""
        return 0.0

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places on the line; at both ends exactly."""
        late = share[:, None]
        return (1.0 - late) * self.ends_m[0] + late * self.ends_m[1]


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """A motion over n steps, after which it stands."""

    places_m: NDArray[np.float64]  # (n + 1, 2) now and at each step's end
    ways: tuple[TimedWay, ...] = ()  # Of each step; none where all are straight and even

    @property
    def steps(self) -> int:
        """Return the number of steps, n."""
        return len(self.places_m) - 1

    def way(self, step: int) -> TimedWay:
        """Return the way of step number `step`, 0 the first; standing after the last."""
        if step >= self.steps:
            return EvenWay(self.places_m[-1:].repeat(2, axis=0))
        return self.ways[step] if self.ways else EvenWay(self.places_m[step : step + 2])

    def lasting(self, steps: int) -> TimedMotion:
        """The same over `steps` steps, standing where it has fewer."""
        places = self.places_m[np.minimum(np.arange(steps + 1), self.steps)]
        return TimedMotion(places, tuple(map(self.way, range(steps))) if self.ways else ())

    def after(self, steps: int) -> TimedMotion:
        """Return the rest of the motion after some steps, at most all."""
        return TimedMotion(self.places_m[steps:], self.ways[steps:])

    @property
    def bulges_m(self) -> NDArray[np.float64]:
        """Return the largest distance from even motion on each step's line; ``(n,)``."""
        if not self.ways:
            return np.zeros(self.steps)
        ends = zip(self.ways, self.places_m[:-1], self.places_m[1:], strict=True)
        return np.array([_bulge_m(way, begin, end) for way, begin, end in ends])


def _bulge_m(way: TimedWay, begin_m: NDArray[np.float64], end_m: NDArray[np.float64]) -> float:
    breaks = way.breaks
    even = begin_m + breaks[:, None] * (end_m - begin_m)
    off = np.linalg.norm(way.at(breaks) - even, axis=1).max()
    part = np.diff(breaks).max()
    return float(off) + way.curving_m * float(part) ** 2 / 8.0 + way.within_m


def closest_approach_m(
    first_starts_m: NDArray[np.float64],
    first_ends_m: NDArray[np.float64],
    second_starts_m: NDArray[np.float64],
    second_ends_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Least distance of two points that move straight and evenly over the same time.

    Seen from the second point the first one moves straight, from r to r + d; it is nearest at the
    share ``t = clip(-r . d / d . d, 0, 1)`` of the time, at the distance ``|r + t d|``.
    """
    # Shapes: first_starts_m, first_ends_m, second_starts_m, second_ends_m (..., 2).
    return np.asarray(
        np.linalg.norm(
            nearest_to_origin_m(first_starts_m - second_starts_m, first_ends_m - second_ends_m),
            axis=-1,
        )
    )


def nearest_to_origin_m(
    starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The place of each segment (..., 2) that is nearest to the origin; ``(..., 2)``."""
    along = ends_m - starts_m
    square = (along * along).sum(axis=-1)
    share = -(starts_m * along).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    share = np.clip(np.where(square > 0.0, share, 0.0), 0.0, 1.0)
    # Counted from the nearer end, so that an end comes out exactly.
    late = share[..., None] > 0.5
    return np.where(
        late, ends_m - (1.0 - share[..., None]) * along, starts_m + share[..., None] * along
    )


CLOSE_M = 1e-7
"""What is found is at most this much below the least distance: a tenth of the verifier's tolerance.
Closer would be dear where two motions keep one distance all the way."""

CLOSE_SHARE = 1e-9
"""The same as a share of how far ways curve: ways that curve by kilometres are no robot's."""


def way_distance_m(first: TimedWay, second: TimedWay, at_most_m: float = math.inf) -> float:
    """Least distance of two ways of one step at equal times, never too large."""
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


def step_distances_m(first: TimedMotion, second: TimedMotion, steps: int) -> NDArray[np.float64]:
    """Least distance during each of `steps` steps, never too large; ``(steps,)``.

    Either stands after its own last step.
    """
    one, other = first.lasting(steps), second.lasting(steps)
    if not one.ways and not other.ways:
        return chord_distances_m(one, other)
    return np.array([way_distance_m(one.way(k), other.way(k)) for k in range(steps)])


def chord_distances_m(first: TimedMotion, second: TimedMotion) -> NDArray[np.float64]:
    """Least distance as if both moved straight and evenly; ``(n,)`` of as many steps."""
    a, b = first.places_m, second.places_m
    return closest_approach_m(a[:-1], a[1:], b[:-1], b[1:])


def least_gap(
    first: TimedMotion, second: TimedMotion, taken_m: NDArray[np.float64]
) -> tuple[float, int]:
    """Least of distance less `taken_m` (n,) over n steps, and the step that has it.

    Steps are looked at in the order of what they may have at least.
    """
    steps = len(taken_m)
    one, other = first.lasting(steps), second.lasting(steps)
    gaps = chord_distances_m(one, other) - taken_m
    if not one.ways and not other.ways:
        return float(gaps.min()), int(gaps.argmin())
    lower = gaps - one.bulges_m - other.bulges_m
    best, at = math.inf, 0
    for k in np.argsort(lower, kind="stable").tolist():
        if lower[k] >= best:
            break
        gap = way_distance_m(one.way(k), other.way(k), best + float(taken_m[k])) - float(taken_m[k])
        if gap < best:
            best, at = gap, k
    return best, at
