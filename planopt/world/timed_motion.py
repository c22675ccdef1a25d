"""A motion over time: the ways of several steps, one after the other.

Within a step times are shares of it. A way says how far it curves, ``|p''| <= c`` by share, so that
between two times that are d apart the place is nowhere farther than ``c d^2 / 8`` from even motion
on the straight line between the places at both.
"""

from __future__ import annotations

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
