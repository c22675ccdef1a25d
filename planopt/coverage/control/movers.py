"""Motion of agents toward their targets, by a control law or on a receding horizon."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.coverage.control.programme import Inertia, solve_programme
from planopt.coverage.control.radio import radio_tree
from planopt.coverage.control.safe_sets import (
    UNBOUNDED,
    SafeSets,
    ground_sets,
    joined,
    separate_cells,
)
from planopt.coverage.geodesic import Ground
from planopt.coverage.ground import Cover
from planopt.coverage.limits import Motion, MoveLimits, RadioLimits
from planopt.coverage.voronoi import merge_coincident
from planopt.errors import InputError

BLENDS = (1.0, 0.999, 0.99, 0.9, 0.5)
"""Blending factors of planned move and braking, tried in turn before pure braking."""
HEAVY = 1e3  # Maximum ratio between the masses of an agent's cell at two steps of a plan
ROUNDING = 1e-12  # Tolerance of positions outside their sets, as a share of the ground's radius
SPLIT = 1e-9
"""Distance, as a share of the region's radius, by which coincident agents are moved apart."""
Partition = Literal["all", "coverage_only"]
"""Agents that get a cell of the region: all agents, or only the covering ones."""


@dataclass(frozen=True)
class Gains:
    """Gains of the control laws."""

    event_per_s: float = 1.0  # Gain k_1 of agents that respond to an event, in 1/s
    coverage_per_s: float = 1.0  # Gain k_2 of covering agents, in 1/s

    def shares(self, responds: Mask, time_step_s: float) -> Floats:
        """Return the share (n,) of the distance to its target that each agent moves in a step."""
        largest = max(self.event_per_s, self.coverage_per_s) * time_step_s
        if not 0.0 < largest <= 1.0 + 1e-12:
            raise InputError(
                f"is {time_step_s:g} s; multiplied by the largest gain it is {largest:g}",
                key="control.time_step_s",
                remedy="keep this product above 0 and at most 1, otherwise agents overshoot",
            )
        return np.minimum(
            time_step_s * np.where(responds, self.event_per_s, self.coverage_per_s), 1.0
        )


def coverage_aims(
    ground: Ground,
    agents_m: Floats,  # (n, 2) positions of all agents
    responds: Mask,  # (n,) mask of the agents that respond to an event
    partition: Partition = "all",
) -> Cover:
    """Return coverage cost and targets, with responding agents fixed at their positions."""
    alone = partition == "coverage_only" and not responds.all()
    counted = ~responds if alone else np.ones_like(responds)
    found = ground.cover(_apart(ground, agents_m, ~responds)[counted])
    targets, mass, covers = agents_m.copy(), np.zeros(len(agents_m)), ~responds[counted]
    targets[~responds], mass[~responds] = found.targets_m[covers], found.mass[covers]
    return Cover(found.cost, targets, mass)


def _apart(ground: Ground, agents_m: Floats, covers: Mask) -> Floats:
    """Return positions (n, 2), with coincident covering agents spread over a tiny ring."""
    within_m = 0.5 * SPLIT * ground.hull.radius_m
    if np.diff(np.sort(agents_m[covers, 0])).min(initial=np.inf) > within_m:
        return agents_m
    group = merge_coincident(agents_m[covers], within_m)[1]
    size = np.bincount(group)[group]
    order = np.argsort(group, kind="stable")
    rank = np.empty(len(group), dtype=np.intp)
    rank[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
    angle = 2.0 * np.pi * rank / size
    ring = np.stack((np.cos(angle), np.sin(angle)), axis=1) * (size > 1)[:, None]
    moved = agents_m.copy()
    moved[covers] = ground.nearest(agents_m[covers] + SPLIT * ground.hull.radius_m * ring)
    return moved


def law_moves(
    agents_m: Floats,
    targets_m: Floats,
    responds: Mask,
    gains: Gains,
    time_step_s: float,
    speed_m_s: float | None = None,
) -> Floats:
    """Return the positions (n, 2) after one step of the control laws at limited speed."""
    most_m = math.inf if speed_m_s is None else speed_m_s * time_step_s
    return _clipped_moves(agents_m, targets_m, gains.shares(responds, time_step_s), most_m)


def _clipped_moves(agents: Floats, targets: Floats, share: Floats, most_m: float) -> Floats:
    """Return end points of moves toward targets by a share (n,), limited to length `most_m`."""
    move = share[:, None] * (targets - agents)
    length = np.linalg.norm(move, axis=1)
    return agents + move * np.minimum(1.0, most_m / np.where(length > 0.0, length, 1.0))[:, None]


@dataclass(frozen=True, eq=False)
class Plan:
    """Plan of `n` agents: the state after the first move, and positions over the horizon."""

    motion: Motion
    paths_m: Floats  # (n, N, 2)


@dataclass(frozen=True, eq=False)
class Aims:
    """Targets of `n` agents over a horizon of `N` steps."""

    places_m: Floats  # (n, N, 2)
    masses: Floats  # (n, N) masses of the cells relative to those at the end of the horizon

    @property
    def steady(self) -> Mask:
        """Return a mask (n,) of the agents whose target and mass are constant over the horizon."""
        places, masses = self.places_m, self.masses
        return (places == places[:, :1]).all(axis=(1, 2)) & (masses == 1.0).all(axis=1)


def held_aims(targets_m: Floats, horizon: int) -> Aims:
    """Return aims with constant targets (n, 2) over the horizon."""
    return Aims(np.repeat(targets_m[:, None], horizon, axis=1), np.ones((len(targets_m), horizon)))


def foreseen_aims(
    ground: Ground,
    agents_m: Floats,  # (n, 2)
    targets_m: Floats,  # (n, 2) present targets
    pending_m: Floats,  # (n, m, 2) positions that the agents planned in the last step, m <= N
    responds: Mask,
    horizon: int,
    share: Floats,  # (n,) share of its distance to the target that an agent moves in a step
    most_m: float,  # Largest length of a move
    partition: Partition = "all",
) -> Aims:
    """Return aims at future cell centroids, computed from the positions that agents planned."""
    found, places = held_aims(targets_m, horizon), agents_m
    covers, ends = ~responds, np.where(responds[:, None], agents_m, targets_m)
    for step in range(horizon):
        moved = _clipped_moves(places, ends, share, most_m)
        places = ground.nearest(pending_m[:, step] if step < pending_m.shape[1] else moved)
        cover = coverage_aims(ground, places, responds, partition)
        ends = cover.targets_m
        found.places_m[covers, step], found.masses[covers, step] = ends[covers], cover.mass[covers]
    last = found.masses[:, -1:]
    weights = found.masses / np.where(last > 0.0, last, 1.0)
    return Aims(found.places_m, np.where(last > 0.0, weights, 1.0).clip(1.0 / HEAVY, HEAVY))


def plan_moves(
    ground: Ground,
    motion: Motion,
    targets_m: Floats | Aims,  # (n, 2)
    limits: MoveLimits,
    gain_per_s: float | Floats,
    horizon: int,
    *,
    kept: SafeSets = UNBOUNDED,  # Additional safe sets of the agents
    drifts_m_s: Floats | None = None,  # (n, 2) velocities of the targets; zero if None
) -> Plan:
    """Plan the motion of all agents over a horizon."""
    # The first move equals the control law ``k (target - p)`` if targets are held and no constraint
    # is active. During the whole move bodies never touch each other and keep clear of obstacles and
    # the outer boundary. A feasible stop always remains.
    places, step_s = motion.places_m, limits.time_step_s
    share = np.broadcast_to(np.asarray(gain_per_s, dtype=np.float64) * step_s, (len(places),))
    drifts = np.zeros_like(places) if drifts_m_s is None else step_s * drifts_m_s
    aims = targets_m if isinstance(targets_m, Aims) else held_aims(targets_m, horizon)
    task = _Task(ground, places, aims, drifts, limits, np.minimum(share, 1.0), horizon, kept)
    if limits.acceleration_m_s2 is not None:
        after, rates, paths = _inert_moves(task, step_s * motion.velocities_m_s)
        return Plan(Motion(after, rates / step_s, motion.headings_rad), paths)
    after, sets, paths = _instant_moves(task)
    headings = motion.headings_rad
    if limits.turn_rate_rad_s is not None:
        after, headings = _driven(places, after, headings, limits)
    move = sets.share_inside(places, after)[:, None] * (after - places)
    return Plan(Motion(places + move, move / step_s, headings), paths)


@dataclass(frozen=True, eq=False)
class _Task:
    """Planning problem of one step for `n` agents."""

    ground: Ground
    places: Floats  # (n, 2)
    aims: Aims
    drifts: Floats  # (n, 2) motion of the aims in a step
    limits: MoveLimits
    share: Floats  # (n,) share of its distance to the target that an agent moves in a step
    horizon: int
    kept: SafeSets  # Additional safe sets of the agents

    @property
    def most_m(self) -> float:
        """Return the largest displacement in a step."""
        return self.limits.speed_m_s * self.limits.time_step_s

    def sets(self, stops: Floats, step_m: Floats, reach_m: float) -> SafeSets:
        """Return the safe sets of agents whose braking paths end at `stops` (n, 2)."""
        body_m = self.limits.body_radius_m
        cells = separate_cells(self.places, stops, body_m, step_m)
        keep_m = max(body_m, self.limits.clearance_m)
        free = ground_sets(
            self.ground, self.places, stops, self.aims.places_m[:, -1], keep_m, reach_m
        )
        return joined(cells, free, self.kept)


def _instant_moves(task: _Task) -> tuple[Floats, SafeSets, Floats]:
    """Plan moves of single integrators, which stop instantly."""
    # Returns the end points of the first moves (n, 2), the safe sets, and paths (n, N, 2).
    places, share, drifts, aims = task.places, task.share, task.drifts, task.aims
    steady, targets = aims.steady, aims.places_m[:, 0]
    far_m = np.linalg.norm(aims.places_m - places[:, None], axis=2).max(axis=1)
    step_m = np.where(steady, share, 1.0) * far_m
    step_m = np.minimum(task.most_m, step_m + np.linalg.norm(drifts, axis=1))
    sets = task.sets(places, step_m, float(task.horizon * step_m.max()))
    paths = places[:, None].repeat(task.horizon + 1, axis=1)
    for step in range(task.horizon):
        paths[:, step + 1] = _clipped_moves(paths[:, step], targets, share, task.most_m)
    paths = paths[:, 1:]
    clear = steady & (sets.share_inside(places, targets) >= 1.0) & ~drifts.any(axis=1)
    who = np.flatnonzero(~clear)
    if len(who):
        mine = sets.of(who).thinned(places[who], task.horizon * step_m[who])
        found = solve_programme(
            places[who], aims.places_m[who], share[who], task.horizon, task.most_m, mine,
            drifts_m=drifts[who], masses=aims.masses[who],
        )  # fmt: skip
        paths[who] = places[who, None] if found is None else found[0][:, 1:]
    return paths[:, 0], sets, paths


def _inert_moves(task: _Task, now: Floats) -> tuple[Floats, Floats, Floats]:
    """Plan moves of double integrators with velocities (n, 2) in metres per step."""
    # An agent brakes if no planned move is feasible.
    assert task.limits.acceleration_m_s2 is not None
    places, most, horizon = task.places, task.most_m, task.horizon
    change = task.limits.acceleration_m_s2 * task.limits.time_step_s**2
    speed = np.linalg.norm(now, axis=1)
    if not _shorter(now, most).all():
        raise InputError(
            f"agent {int(speed.argmax())} exceeds its maximum speed of "
            f"{task.limits.speed_m_s:g} m/s",
            key="velocities",
        )
    stops = places + braking_offsets_m(now, change)
    fastest = np.minimum(speed + change, most)
    later = np.maximum(np.ceil(fastest / change - 1e-9), 1.0)
    inertia = Inertia(now, change, later.astype(np.intp))
    # Over the horizon, braking paths are bounded by the largest speed.
    reach_m = most * (horizon + 0.5 * math.ceil(most / change))
    sets = task.sets(stops, fastest * (1.0 + 0.5 * later), reach_m)
    # Agents may always brake at a constant rate.
    steps = _stop_steps(now, change)[:, None]
    left = np.maximum(1.0 - np.arange(horizon + 1) / np.maximum(steps, 1.0), 0.0)
    rates = left[:, :, None] * now[:, None]
    path = np.zeros_like(rates) + places[:, None]
    path[:, 1:] += np.cumsum(0.5 * (rates[:, 1:] + rates[:, :-1]), axis=1)
    reserves = path + 0.5 * later[:, None, None] * rates
    wide = sets.widened(np.concatenate((path, reserves), axis=1))
    wide = wide.thinned(places, np.full(len(places), reach_m))
    found = solve_programme(
        places, task.aims.places_m, task.share, horizon, most, wide, inertia, task.drifts,
        task.aims.masses,
    )  # fmt: skip
    planned, faster = (path, rates) if found is None else found
    after, rate, brakes = path[:, 1].copy(), rates[:, 1].copy(), np.ones(len(places), dtype=bool)
    slack = ROUNDING * task.ground.hull.radius_m
    for blend in BLENDS:
        ends = blend * planned[:, 1] + (1.0 - blend) * path[:, 1]
        speeds = blend * faster[:, 1] + (1.0 - blend) * rates[:, 1]
        reserve = np.stack((places + 0.5 * now, ends, ends + braking_offsets_m(speeds, change)), 1)
        fine = brakes & sets.holds(reserve, slack) & _shorter(speeds, most)
        fine &= _shorter(speeds - now, change)
        after[fine], rate[fine] = ends[fine], speeds[fine]
        brakes &= ~fine
    return after, rate, planned[:, 1:]


def braking_offsets_m(velocities_m: Floats, change_m: float) -> Floats:
    """Return the offsets ``(n, 2)`` from double integrators to their stopping positions."""
    # Velocities ``(n, 2)`` and the largest change of velocity are in metres per step.
    return 0.5 * _stop_steps(velocities_m, change_m)[:, None] * velocities_m


def _shorter(vectors: Floats, most: float) -> Mask:
    """Return a mask (n,) of the vectors (n, 2) of length at most `most`, up to rounding."""
    return np.linalg.norm(vectors, axis=1) <= most * (1.0 + 1e-9)


def _stop_steps(rates: Floats, change: float) -> Floats:
    """Return the minimum number (n,) of braking steps from velocities (n, 2)."""
    return np.ceil(np.linalg.norm(rates, axis=1) / change - 1e-9)


def _driven(
    places: Floats, ends: Floats, headings: Floats, limits: MoveLimits
) -> tuple[Floats, Floats]:
    """Return the positions and headings after unicycles turn and drive toward `ends` (n, 2)."""
    assert limits.turn_rate_rad_s is not None
    offset = ends - places
    length = np.linalg.norm(offset, axis=1)
    turn = np.arctan2(offset[:, 1], offset[:, 0]) - headings
    # With reverse driving a quarter turn suffices.
    turn -= np.pi * np.round(turn / np.pi)
    turn[length == 0.0] = 0.0
    most = limits.turn_rate_rad_s * limits.time_step_s
    left_s = limits.time_step_s - np.abs(turn) / limits.turn_rate_rad_s
    move = np.where(left_s > 0.0, np.minimum(length, limits.speed_m_s * left_s), 0.0)
    share = np.where(length > 0.0, move / np.where(length > 0.0, length, 1.0), 0.0)
    return places + share[:, None] * offset, headings + np.clip(turn, -most, most)


@dataclass(frozen=True)
class LawMover:
    """Motion of agents by the control laws with clipped speed."""

    gains: Gains
    time_step_s: float
    speed_m_s: float | None

    def __call__(
        self,
        ground: Ground,
        motion: Motion,
        aims: Aims,  # Their drifts (n, 2) are the estimated target velocities
        responds: Mask,  # (n,)
        drifts_m_s: Floats,
    ) -> Plan:
        """Return the plan of one control-law step toward the first aims of the horizon."""
        here, gains, targets_m = motion.places_m, self.gains, aims.places_m[:, 0]
        moved = law_moves(here, targets_m, responds, gains, self.time_step_s, self.speed_m_s)
        velocities = (moved - here) / self.time_step_s
        return Plan(Motion(moved, velocities, motion.headings_rad), moved[:, None])


@dataclass(frozen=True)
class RecedingMover:
    """Motion of agents by the first moves of receding-horizon plans."""

    gains: Gains
    limits: MoveLimits
    horizon: int
    radio: RadioLimits | None = None  # Required links to base stations
    lead: bool = False  # Whether plans predict moving targets; otherwise targets are held constant
    deploys: bool = False  # Whether covering agents drive to a deployment of low cost

    def __call__(
        self, ground: Ground, motion: Motion, aims: Aims, responds: Mask, drifts_m_s: Floats
    ) -> Plan:
        """Return a plan over the horizon toward the aims, which drift if `lead` is true."""
        step_s, kept = self.limits.time_step_s, UNBOUNDED
        most = self.limits.acceleration_m_s2
        if self.radio is not None:
            stops = motion.places_m
            if most is not None:
                rates = motion.velocities_m_s * step_s
                stops = stops + braking_offsets_m(rates, most * step_s**2)
            kept = radio_tree(motion.places_m, self.radio, stops).kept
        gains = self.gains.shares(responds, step_s) / step_s
        drifts = drifts_m_s if self.lead else None
        return plan_moves(
            ground, motion, aims, self.limits, gains, self.horizon, kept=kept, drifts_m_s=drifts
        )


Mover = LawMover | RecedingMover
"""Control law or planner that moves all agents for one step."""
