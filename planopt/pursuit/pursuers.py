"""Pursuers: their motion, and their decisions based on reports.

A pursuer either drives to the reported position, in stages or whenever a fresher report arrives, or
predicts the evader: it filters delayed reports and plans N steps to intercept it. The evader's
velocity follows an Ornstein-Uhlenbeck process (equations 8.15 and 8.16), so that old velocities are
not extrapolated far. Reports enter the filter in order of sample time (rule R).

Pursuers of one evader may cooperate: each blocks directions that the others leave open. The evader
is in the set of positions consistent with the last records of all pursuers. Each pursuer chooses,
among points around that set, the aim that minimises the worst and the mean time to capture over
straight flights from these positions, given the aims of the others (equation 8.20).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats
from planopt.pursuit.arena import Arena
from planopt.pursuit.service import Record
from planopt.robots.models import Unicycle

PLACES, FLIGHTS, BEARINGS = 24, 24, 16
"""Number of positions in the set, of flight directions, and of directions of candidate aims."""
RINGS = (0.5, 1.0, 2.0)
"""Distances of candidate aims from the centre, as shares of the evader's range until arrival."""
GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))
"""Golden angle, by which positions in the set are spread."""


@dataclass(frozen=True, eq=False)
class Mate:
    """Another pursuer of the same evader."""

    place_m: Floats  # (2,)
    aim_m: Floats  # (2,) point that it drives to
    speed_m_s: float
    record: Record | None  # Its record in use


ARRIVED_M = 1e-9  # Distance below which a point counts as reached, since its bearing is undefined
ARRIVED_SHARE = 1e-6
"""Distance below which a waypoint counts as reached, relative to the step length."""


@dataclass(frozen=True)
class StraightMotion:
    """Motion model of a single integrator."""

    speed_max_m_s: float
    turning_s: float = 0.0  # Maximum delay due to turning, compared with a straight drive

    def start(self, place_m: Floats) -> Floats:
        """Return the position as the initial state."""
        return place_m

    def towards(self, states: Floats, aims_m: Floats, step_s: float) -> Floats:
        """Return positions after a straight drive, which stops at the point."""
        offset = aims_m - states
        away = np.linalg.norm(offset, axis=-1, keepdims=True)
        share = np.minimum(1.0, self.speed_max_m_s * step_s / np.maximum(away, ARRIVED_M))
        return states + share * offset


@dataclass(frozen=True)
class UnicycleMotion:
    """Unicycle that turns on the spot and drives straight, or drives an arc if that is faster."""

    robot: Unicycle
    arcs: bool = True  # False among obstacles, where only the straight route is known to be free

    @property
    def speed_max_m_s(self) -> float:
        """Return the maximum forward speed."""
        return self.robot.speed_max_m_s

    @property
    def turning_s(self) -> float:
        """Return the time of a half turn on the spot."""
        return math.pi / self.robot.turn_rate_max_rad_s

    def start(self, place_m: Floats) -> Floats:
        """Return the position with heading 0."""
        return np.append(place_m, 0.0)

    def towards(self, states: Floats, aims_m: Floats, step_s: float) -> Floats:
        """Return states after a turn and a drive with constant inputs over each part."""
        # The arc to a point at bearing b and distance d has length ``d b / sin b`` and turns by 2
        # b. It is used if it takes less time than turning by b and driving d.
        speed, rate = self.robot.speed_max_m_s, self.robot.turn_rate_max_rad_s
        offset = aims_m - states[..., :2]
        away = np.linalg.norm(offset, axis=-1)
        bearing = np.arctan2(offset[..., 1], offset[..., 0]) - states[..., 2]
        bearing = np.where(away > ARRIVED_M, np.remainder(bearing + np.pi, 2 * np.pi) - np.pi, 0.0)
        # Points behind the robot cannot be reached by an arc of less than half a turn.
        ahead = np.abs(bearing) < 0.5 * np.pi
        along = away / np.sinc(np.where(ahead, bearing, 0.0) / np.pi)
        arc_s = np.maximum(along / speed, 2.0 * np.abs(bearing) / rate)
        spot_s = np.abs(bearing) / rate
        arcs = self.arcs & ahead & (arc_s <= spot_s + away / speed)
        turn_s = np.where(arcs, 0.0, np.minimum(spot_s, step_s))
        turned = self._after(states, np.zeros_like(away), rate * np.sign(bearing), turn_s)
        lasts_s = np.where(arcs, arc_s, away / speed)
        drive_s = np.minimum(step_s - turn_s, lasts_s)
        some = np.maximum(lasts_s, ARRIVED_M)
        forward = np.asarray(np.where(arcs, along, away), dtype=np.float64) / some
        return self._after(turned, forward, np.where(arcs, 2.0 * bearing / some, 0.0), drive_s)

    def _after(
        self, states: Floats, speed_m_s: Floats, rate_rad_s: Floats, lasts_s: Floats
    ) -> Floats:
        """Return the exact states after inputs that are constant over durations (...)."""
        moved = self.robot.step(
            (states[..., 0], states[..., 1], states[..., 2]),
            (speed_m_s * lasts_s, rate_rad_s * lasts_s),
            1.0,
        )
        return np.stack(moved, axis=-1)


Motion = StraightMotion | UnicycleMotion
"""Motion model of a pursuer; its states (..., s) begin with x and y."""


@dataclass(frozen=True, eq=False)
class PursuerView:
    """Information available to a pursuer's decision."""

    time_s: float  # Current time
    step_s: float  # Time until the next decision
    state: Floats  # State of the pursuer
    ask: Callable[[Record | None], Record | None]  # Local record as a function of the record in use
    mates: Sequence[Mate] = ()  # Other pursuers of the same evader

    @property
    def place_m(self) -> Floats:
        """Return the pursuer's position (2,)."""
        return self.state[:2]


@dataclass(frozen=True, eq=False)
class Quest:
    """Data that a driver receives at the start of a pursuit."""

    motion: Motion  # Motion of the pursuer
    evader_speed_m_s: float  # Maximum speed over all evaders
    arena: Arena
    capture_radius_m: float = 0.0


def consistent_m(
    records: Sequence[Record], time_s: float, evader_speed_m_s: float, arena: Arena
) -> tuple[Floats, Floats]:
    """Return the centre (2,) of the set consistent with all records, and positions (k, 2) in it."""
    places_m = np.array([each.reported_m for each in records])
    ranges_m = np.array(
        [each.error_m + evader_speed_m_s * (time_s - each.sampled_s) for each in records]
    )
    best = int(ranges_m.argmin())
    share = np.sqrt((np.arange(PLACES) + 0.5) / PLACES)
    turn = GOLDEN_RAD * np.arange(PLACES)
    spread = share[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    found = arena.within(places_m[best] + ranges_m[best] * spread)
    away_m = np.linalg.norm(found[:, None] - places_m, axis=2)
    kept = found[(away_m <= ranges_m * (1.0 + 1e-9)).all(axis=1)]
    found = kept if len(kept) else found
    return found.mean(axis=0), found


def blocking_aim_m(
    quest: Quest, view: PursuerView, centre_m: Floats, places_m: Floats, horizon_s: float
) -> Floats:
    """Return the aim (2,) of least time to capture, given the aims of the other pursuers."""
    speed_m_s = quest.motion.speed_max_m_s
    turn = np.arange(FLIGHTS) * (2.0 * np.pi / FLIGHTS)
    velocity = quest.evader_speed_m_s * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ahead_s = min(horizon_s, float(np.linalg.norm(centre_m - view.place_m)) / speed_m_s)
    flown_m = places_m[:, None] + ahead_s * velocity
    others_s = np.full(flown_m.shape[:2], np.inf)
    for mate in view.mates:
        there_m = _driven_m(quest.arena, mate.place_m, mate.aim_m[None], mate.speed_m_s * ahead_s)
        found_s = _capture_s(quest, there_m, mate.speed_m_s, flown_m, velocity)
        others_s = np.minimum(others_s, found_s[0])
    # Candidate aims are the centre of the set, and positions on rings around it.
    turn = np.arange(BEARINGS) * (2.0 * np.pi / BEARINGS)
    ring = quest.evader_speed_m_s * ahead_s * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    aims_m = quest.arena.within(centre_m + np.concatenate([share * ring for share in RINGS]))
    if quest.arena.obstacles is not None:
        aims_m = aims_m[[quest.arena.is_free(each, 1.1) for each in aims_m]]
    aims_m = np.concatenate([quest.arena.free_m(centre_m)[None], aims_m.reshape(-1, 2)])
    there_m = _driven_m(quest.arena, view.place_m, aims_m, speed_m_s * ahead_s)
    own_s = _capture_s(quest, there_m, speed_m_s, flown_m, velocity)
    # The evader flees in the direction of latest capture; its position in the set is unknown.
    soonest_s = np.minimum(own_s, others_s)
    # The mean decides if two pursuers cannot shorten the worst flight. The centre wins ties.
    value_s = np.asarray((soonest_s.max(axis=2) + soonest_s.mean(axis=2)).mean(axis=1))
    return aims_m[int(value_s.round(6).argmin())]


def _driven_m(arena: Arena, place_m: Floats, aims_m: Floats, range_m: float) -> Floats:
    """Return positions (k, 2) after driving `range_m` towards aims, placed on straight lines."""
    lengths_m = np.maximum(arena.distances_m(place_m, aims_m), 1e-9)
    return place_m + np.minimum(1.0, range_m / lengths_m)[:, None] * (aims_m - place_m)


def _capture_s(
    quest: Quest, pursuers_m: Floats, speed_m_s: float, evaders_m: Floats, velocity: Floats
) -> Floats:
    """Return the times in which pursuers capture evaders that flee along straight lines."""
    # The root s of |apart + velocity s| = speed s + radius.
    apart = evaders_m - pursuers_m[:, None, None]
    radius_m = quest.capture_radius_m
    square = speed_m_s**2 - quest.evader_speed_m_s**2
    half = speed_m_s * radius_m - (apart * velocity).sum(axis=-1)
    over = (apart * apart).sum(axis=-1) - radius_m**2
    if square <= 0.0:
        return np.sqrt(np.maximum(over, 0.0)) / speed_m_s
    root = (-half + np.sqrt(np.maximum(half * half + square * over, 0.0))) / square
    return np.where(over <= 0.0, 0.0, root)


def fresher(found: Record, held: Record | None) -> bool:
    """Return whether the record `found` replaces the record `held` by rule R."""
    # A record never replaces one with a later sample time; of equal ones the more exact is used.
    if held is None or found.sampled_s > held.sampled_s:
        return True
    return found.sampled_s == held.sampled_s and found.error_m < held.error_m


class DriveToReport:
    """Driver that follows one record along the shortest path to the reported position."""

    # With `retarget` a fresher record is used at once; otherwise the next one is taken on arrival,
    # in stages, as the guarantees require.

    def __init__(self, quest: Quest, *, retarget: bool = False) -> None:
        self._quest, self._retarget = quest, retarget
        self._route = np.zeros((0, 2))
        self.record: Record | None = None  # The record that the pursuer follows

    def aim_m(self, view: PursuerView) -> Floats:
        """Return the pursuer's current target point (2,)."""
        self._route = _remaining(self._route, view, self._quest)
        if self._retarget or not len(self._route):
            found = view.ask(self.record)
            if found is not None and fresher(found, self.record):
                self.record = found
                self._route = self._quest.arena.route_m(view.place_m, found.reported_m)
        return self._route[0] if len(self._route) else view.place_m


def _remaining(route_m: Floats, view: PursuerView, quest: Quest) -> Floats:
    """Return the waypoints (k, 2) of a route that are not yet reached."""
    near_m = ARRIVED_SHARE * quest.motion.speed_max_m_s * view.step_s
    while len(route_m) and np.linalg.norm(route_m[0] - view.place_m) <= near_m:
        route_m = route_m[1:]
    return route_m


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated position and velocity of an evader; the axes are independent and identical."""

    time_s: float
    mean: Floats  # (2, 2) rows position [m] and velocity [m/s], one column per axis
    covariance: Floats  # (2, 2) of position and velocity, for each axis


def predicted(estimate: Estimate, time_s: float, speed_m_s: float, manoeuvre_s: float) -> Estimate:
    """Return the estimate at a later time."""
    # The stationary velocity has standard deviation ``speed / sqrt 2`` per axis, which determines
    # the process noise.
    lasts_s = max(0.0, time_s - estimate.time_s)
    kept = math.exp(-lasts_s / manoeuvre_s)
    reach_s = manoeuvre_s * (1.0 - kept)
    step = np.array([[1.0, reach_s], [0.0, kept]])
    # Integrals of the process noise 2 variance / T over the transition.
    both = manoeuvre_s * (1.0 - kept) ** 2
    position = 2.0 * manoeuvre_s * (lasts_s - reach_s) - reach_s**2
    noise = 0.5 * speed_m_s**2 * np.array([[position, both], [both, 1.0 - kept**2]])
    return Estimate(
        max(time_s, estimate.time_s),
        step @ estimate.mean,
        step @ estimate.covariance @ step.T + noise,
    )


def updated(estimate: Estimate, record: Record) -> Estimate:
    """Return the estimate updated with a record, at the record's time."""
    variance = record.error_m**2 / 6.0
    gain = estimate.covariance[:, 0] / (estimate.covariance[0, 0] + variance)
    mean = estimate.mean + np.outer(gain, record.reported_m - estimate.mean[0])
    covariance = estimate.covariance - np.outer(gain, estimate.covariance[0])
    return Estimate(estimate.time_s, mean, covariance)


class RecedingHorizon:
    """Driver that predicts the evader N plan steps ahead and drives to the first meeting point."""

    # A plan is made for every fresher record, and once per plan step. Several pursuers of one
    # evader cooperate instead.

    def __init__(
        self,
        quest: Quest,
        *,
        horizon: int,  # N, in plan steps
        plan_step_s: float,  # Duration of a plan step
        manoeuvre_s: float,  # Correlation time of the evader's velocity
    ) -> None:
        self._quest, self._manoeuvre_s = quest, manoeuvre_s
        self._horizon, self._plan_step_s = horizon, plan_step_s
        self._estimate: Estimate | None = None
        self._route = np.zeros((0, 2))
        self._planned_s = -math.inf
        self.record: Record | None = None  # The record that the pursuer follows

    def aim_m(self, view: PursuerView) -> Floats:
        """Return the pursuer's current target point (2,)."""
        found = view.ask(self.record)
        fresh = found is not None and fresher(found, self.record)
        if found is not None and fresh:
            speed = self._quest.evader_speed_m_s
            if self._estimate is None:
                mean = np.array([found.reported_m, np.zeros(2)])
                spread = np.diag([found.error_m**2 / 6.0, 0.5 * speed**2])
                self._estimate = Estimate(found.sampled_s, mean, spread)
            else:
                ahead = predicted(self._estimate, found.sampled_s, speed, self._manoeuvre_s)
                self._estimate = updated(ahead, found)
            self.record = found
        if self._estimate is None:
            return view.place_m
        self._route = _remaining(self._route, view, self._quest)
        stale = view.time_s - self._planned_s >= self._plan_step_s
        if fresh or stale or not len(self._route):
            goal_m = self._goal_m(view, self._estimate)
            self._route = self._quest.arena.route_m(view.place_m, goal_m)
            self._planned_s = view.time_s
        return self._route[0] if len(self._route) else view.place_m

    def _goal_m(self, view: PursuerView, estimate: Estimate) -> Floats:
        if not view.mates:
            return self._meeting_m(view, estimate)
        quest = self._quest
        held = [each.record for each in view.mates if each.record is not None]
        records = held if self.record is None else [self.record, *held]
        centre_m, places_m = consistent_m(records, view.time_s, quest.evader_speed_m_s, quest.arena)
        horizon_s = self._horizon * self._plan_step_s
        return blocking_aim_m(quest, view, centre_m, places_m, horizon_s)

    def _meeting_m(self, view: PursuerView, estimate: Estimate) -> Floats:
        """Return the first predicted position that the pursuer reaches in time, else the last."""
        arena, speed = self._quest.arena, self._quest.evader_speed_m_s
        ahead_s = self._plan_step_s * np.arange(1, self._horizon + 1)
        velocity = estimate.mean[1] * min(
            1.0, speed / max(float(np.linalg.norm(estimate.mean[1])), 1e-12)
        )
        since_s = view.time_s - estimate.time_s + ahead_s
        moved_s = self._manoeuvre_s * -np.expm1(-since_s / self._manoeuvre_s)
        places_m = estimate.mean[0] + moved_s[:, None] * velocity
        places_m = np.array([arena.free_m(place) for place in places_m])
        away_m = arena.distances_m(view.place_m, places_m)
        met = away_m <= self._quest.motion.speed_max_m_s * ahead_s
        return places_m[int(met.argmax()) if met.any() else -1]


Driver = DriveToReport | RecedingHorizon
"""Decision maker of a pursuer that chases one evader."""
Policy = Callable[[Quest], Driver]
"""Function that returns the driver for one pursuit of one evader, without a record."""
