"""The decisions of pursuers: drive to the reported place, in stages or to every new report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.pursuit.arena import Arena
from planopt.pursuit.motion import Motion
from planopt.pursuit.records import Record

Ask = Callable[[Record | None], Record | None]
"""Asks for a record, given the one in use."""

ARRIVED_SHARE = 1e-6
"""Of a step's way: nearer than this a place is reached."""


@dataclass(frozen=True, eq=False)
class PursuerView:
    """The knowledge that a pursuer decides on."""

    time_s: float  # Now, and until the next decision
    step_s: float
    state: NDArray[np.float64]  # Its own; x and y first
    ask: Ask  # Returns what is known here and now

    @property
    def place_m(self) -> NDArray[np.float64]:
        """``(2,)``."""
        return self.state[:2]


class Driver(Protocol):
    """A pursuer's decisions in one pursuit of one evader."""

    @property
    def record(self) -> Record | None:
        """The record in use."""
        ...

    def aim_m(self, view: PursuerView) -> NDArray[np.float64]:
        """Return where to drive, ``(2,)``."""
        ...


@dataclass(frozen=True, eq=False)
class Quest:
    """The task that a driver is given at the start."""

    motion: Motion  # How it moves
    evader_speed_m_s: float  # No evader is faster
    capture_radius_m: float  # At which the evader is caught
    arena: Arena  # Where it may go
    generator: np.random.Generator  # Source of randomness


class Policy(Protocol):
    """A kind of pursuer."""

    def begin(self, quest: Quest) -> Driver:
        """Return what decides in one pursuit of one evader."""
        ...


@dataclass(frozen=True)
class DriveToReport:
    """Drive to the reported place, round obstacles."""

    # Whether any fresher record is taken at once. Otherwise the next one is taken on arrival, in
    # stages, which is what the guarantees are about.
    retarget: bool = False
    # Rule R: never replace a record by one with an older sample time; of equal ones take the more
    # exact. Without it whatever record is there is taken.
    in_order: bool = True

    def begin(self, quest: Quest) -> Driver:
        """Return a driver without a record."""
        return _ReportDriver(self, quest)


class _ReportDriver:
    """The record in use and the way to it."""

    def __init__(self, policy: DriveToReport, quest: Quest) -> None:
        self._policy, self._quest = policy, quest
        self._route = np.zeros((0, 2))
        self.record: Record | None = None

    def aim_m(self, view: PursuerView) -> NDArray[np.float64]:
        near_m = ARRIVED_SHARE * self._quest.motion.speed_max_m_s * view.step_s
        while len(self._route) and np.linalg.norm(self._route[0] - view.place_m) <= near_m:
            self._route = self._route[1:]
        if self._policy.retarget or not len(self._route):
            found = view.ask(self.record)
            if found is not None and (not self._policy.in_order or fresher(found, self.record)):
                self.record = found
                self._route = self._quest.arena.route_m(view.place_m, found.reported_m)
        return self._route[0] if len(self._route) else view.place_m


def fresher(found: Record, held: Record | None) -> bool:
    """Return whether rule R replaces a held record by one that is found."""
    if held is None or found.sampled_s > held.sampled_s:
        return True
    return found.sampled_s == held.sampled_s and found.error_m < held.error_m
