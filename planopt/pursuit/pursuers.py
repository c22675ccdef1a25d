"""Pursuers: drive to the reported position, in stages or to every new report, or predict.

A predicting pursuer filters delayed reports and plans N steps to meet the evader. The velocity of
an evader follows an Ornstein-Uhlenbeck process (equations 8.15 and 8.16), so that old velocities
are not extrapolated far. Reports enter the filter at the times at which they were sampled; rule R
keeps these in order, so that a delayed report needs no second pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.pursuit.arena import Arena
from planopt.pursuit.motion import Motion
from planopt.pursuit.records import Record
from planopt.pursuit.service import require_count, require_number

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


@dataclass(frozen=True)
class RecedingHorizon:
    """Predict the evader N plan steps ahead, drive to the first place where it can be met.

    A plan is made anew with every fresher record, and once a plan step.
    """

    horizon: int  # N
    plan_step_s: float  # Length of a plan step
    manoeuvre_s: float  # Time in which an evader forgets its velocity

    def __post_init__(self) -> None:
        require_count(self.horizon, "horizon", 1)
        require_number(self.plan_step_s, "plan_step_s", above=0.0)
        require_number(self.manoeuvre_s, "manoeuvre_s", above=0.0)

    def begin(self, quest: Quest) -> _PlanningDriver:
        """Return a driver that knows nothing yet."""
        return _PlanningDriver(self, quest)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Position and velocity of an evader at a time; axes are independent and alike."""

    time_s: float  # When
    mean: NDArray[np.float64]  # (2, 2) rows position [m] and velocity [m/s], a column an axis
    covariance: NDArray[np.float64]  # (2, 2) of position and velocity on each axis


def predicted(estimate: Estimate, time_s: float, speed_m_s: float, manoeuvre_s: float) -> Estimate:
    """Return the estimate at a later time.

    Velocities have the standard deviation ``speed / sqrt 2`` an axis for ever, which makes the
    process noise what the transition takes away of it.
    """
    lasts_s = max(0.0, time_s - estimate.time_s)
    kept = math.exp(-lasts_s / manoeuvre_s)
    reach_s = manoeuvre_s * (1.0 - kept)
    step = np.array([[1.0, reach_s], [0.0, kept]])
    variance = 0.5 * speed_m_s**2
    # Integrals of the process noise 2 variance / T over the transition.
    noise = variance * np.array(
        [
            [
                2.0 * manoeuvre_s * (lasts_s - reach_s) - reach_s**2,
                manoeuvre_s * (1.0 - kept) ** 2,
            ],
            [manoeuvre_s * (1.0 - kept) ** 2, 1.0 - kept**2],
        ]
    )
    return Estimate(
        max(time_s, estimate.time_s),
        step @ estimate.mean,
        step @ estimate.covariance @ step.T + noise,
    )


def updated(estimate: Estimate, record: Record) -> Estimate:
    """Return the estimate, which is at the record's time, after a report.

    The error is taken as uniform over the square cell whose half diagonal is the record's bound.
    """
    variance = record.error_m**2 / 6.0
    gain = estimate.covariance[:, 0] / (estimate.covariance[0, 0] + variance)
    off_m = record.reported_m - estimate.mean[0]
    mean = estimate.mean + np.outer(gain, off_m)
    covariance = estimate.covariance - np.outer(gain, estimate.covariance[0])
    return Estimate(estimate.time_s, mean, covariance)


class _PlanningDriver:
    """The estimate, and the way to where the evader is to be met."""

    def __init__(self, policy: RecedingHorizon, quest: Quest) -> None:
        self._policy, self._quest = policy, quest
        self._estimate: Estimate | None = None
        self._route = np.zeros((0, 2))
        self._planned_s = -math.inf
        self.record: Record | None = None

    def aim_m(self, view: PursuerView) -> NDArray[np.float64]:
        found = view.ask(self.record)
        fresh = found is not None and fresher(found, self.record)
        if found is not None and fresh:
            self._take(found)
        if self._estimate is None:
            return view.place_m
        near_m = ARRIVED_SHARE * self._quest.motion.speed_max_m_s * view.step_s
        while len(self._route) and np.linalg.norm(self._route[0] - view.place_m) <= near_m:
            self._route = self._route[1:]
        stale = view.time_s - self._planned_s >= self._policy.plan_step_s
        if fresh or stale or not len(self._route):
            goal_m = self._meeting_m(view, self._estimate)
            self._route = self._quest.arena.route_m(view.place_m, goal_m)
            self._planned_s = view.time_s
        return self._route[0] if len(self._route) else view.place_m

    def _take(self, record: Record) -> None:
        speed, policy = self._quest.evader_speed_m_s, self._policy
        if self._estimate is None:
            mean = np.array([record.reported_m, np.zeros(2)])
            spread = np.diag([record.error_m**2 / 6.0, 0.5 * speed**2])
            self._estimate = Estimate(record.sampled_s, mean, spread)
        else:
            ahead = predicted(self._estimate, record.sampled_s, speed, policy.manoeuvre_s)
            self._estimate = updated(ahead, record)
        self.record = record

    def _meeting_m(self, view: PursuerView, estimate: Estimate) -> NDArray[np.float64]:
        """The first predicted place that is reached in time, else the last of the horizon."""
        policy, arena = self._policy, self._quest.arena
        speed = self._quest.evader_speed_m_s
        ahead_s = policy.plan_step_s * np.arange(1, policy.horizon + 1)
        velocity = estimate.mean[1] * min(
            1.0, speed / max(float(np.linalg.norm(estimate.mean[1])), 1e-12)
        )
        since_s = view.time_s - estimate.time_s + ahead_s
        moved_s = policy.manoeuvre_s * -np.expm1(-since_s / policy.manoeuvre_s)
        places_m = estimate.mean[0] + moved_s[:, None] * velocity
        places_m = np.array([arena.free_m(place) for place in places_m])
        away_m = arena.distances_m(view.place_m, places_m)
        met = away_m <= self._quest.motion.speed_max_m_s * ahead_s
        return places_m[int(met.argmax()) if met.any() else -1]
