"""Moves of agents toward their targets in one step: by laws, or by a plan over a horizon."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.control.laws import Gains, law_moves
from planopt.coverage.control.programme import Inertia, saturated_paths, solve_programme
from planopt.coverage.control.radio import radio_tree
from planopt.coverage.control.safe_sets import SafeSets, ground_sets, joined, separate_cells
from planopt.coverage.ground import Ground
from planopt.coverage.limits import MoveLimits, RadioLimits
from planopt.errors import InputError

BLENDS = (1.0, 0.999, 0.99, 0.9, 0.5)
"""Shares of the planned move that are tried, the rest braking, before an agent only brakes."""

ROUNDING = 1e-12
"""Places may be outside of their sets by this share of the ground's radius."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NetworkMoves:
    """Planned moves of all agents. The first one is meant to be driven; then plan again."""

    paths_m: Floats  # (n, N + 1, 2) places at the ends of the steps, the present one first
    # (n, N + 1, 2) velocities on arrival there, the present one first. A double integrator changes
    # its velocity evenly during a step; other agents have that of the step's end at once.
    velocities_m_s: Floats
    headings_rad: Floats | None  # (n,) headings of unicycles after the first move; None for others
    # (n,) whether an agent stands still or brakes because no other move was found
    stopping: NDArray[np.bool_]
    solved: int  # How many agents needed a programme; the others' way was free

    @property
    def next_m(self) -> Floats:
        """Places ``(n, 2)`` after the first move."""
        return self.paths_m[:, 1]


def plan_moves(
    ground: Ground,
    positions_m: Floats,  # (n, 2) where agents are
    targets_m: Floats,  # (n, 2)
    limits: MoveLimits,
    gain_per_s: float | Floats,
    horizon: int,
    *,
    velocities_m_s: Floats | None = None,  # (n, 2)
    headings_rad: Floats | None = None,  # (n,) present headings of unicycles
    kept: SafeSets | None = None,
    target_velocities_m_s: Floats | None = None,  # (n, 2)
) -> NetworkMoves:
    """Plan the moves of all agents over a horizon, with targets that stand or drift.

    The first move equals that of the law ``k (target - p)`` as long as no limit binds. Bodies never
    touch, and keep off obstacles and the border, during the whole move; stopping always stays
    possible.
    """
    places, aims = (
        _checked(values, len(positions_m), key)
        for values, key in ((positions_m, "agents"), (targets_m, "targets"))
    )
    share = np.broadcast_to(np.asarray(gain_per_s, dtype=np.float64), (len(places),))
    share = share * limits.time_step_s
    if horizon < 1 or not ((share > 0.0) & (share <= 1.0 + ROUNDING)).all():
        raise InputError(
            f"a horizon of {horizon} steps of {limits.time_step_s:g} s at these gains",
            key="control.time_step_s",
            remedy="keep gain times step above 0 and at most 1, and the horizon at least 1",
        )
    share = np.minimum(share, 1.0)
    drifts = np.zeros_like(places)
    if target_velocities_m_s is not None:
        velocities = _checked(target_velocities_m_s, len(places), "target_velocities")
        drifts = limits.time_step_s * velocities
    most_m = limits.speed_m_s * limits.time_step_s
    if limits.acceleration_m_s2 is not None:
        velocities = np.zeros_like(places) if velocities_m_s is None else velocities_m_s
        velocities = _checked(velocities, len(places), "velocities")
        return _inert_moves(ground, places, aims, limits, share, horizon, velocities, kept, drifts)
    step_m = share * np.linalg.norm(aims - places, axis=1) + np.linalg.norm(drifts, axis=1)
    step_m = np.minimum(most_m, step_m)
    sets = _sets(ground, places, places, aims, limits, step_m, float(horizon * step_m.max()), kept)
    clear = (sets.share_inside(places, aims) >= 1.0) & ~drifts.any(axis=1)
    paths = saturated_paths(places, aims, share, horizon, most_m)
    stopping = np.zeros(len(places), dtype=np.bool_)
    blocked = np.flatnonzero(~clear)
    if len(blocked):
        mine = sets.of(blocked).thinned(places[blocked], horizon * step_m[blocked])
        found = solve_programme(
            places[blocked], aims[blocked], share[blocked], horizon, most_m, mine,
            drifts_m=drifts[blocked],
        )  # fmt: skip
        paths[blocked] = places[blocked, None] if found is None else found[0]
        stopping[blocked] = found is None
    headings = None
    if limits.turn_rate_rad_s is not None:
        headings = np.zeros(len(places)) if headings_rad is None else headings_rad
        paths[:, 1], headings = _driven(places, paths[:, 1], headings, limits)
    inside = sets.share_inside(places, paths[:, 1])
    paths[:, 1] = places + inside[:, None] * (paths[:, 1] - places)
    velocities = np.diff(paths, axis=1, prepend=paths[:, :1]) / limits.time_step_s
    return NetworkMoves(paths, velocities, headings, stopping, len(blocked))


def _sets(
    ground: Ground,
    places: Floats,
    stops: Floats,
    aims: Floats,
    limits: MoveLimits,
    step_m: Floats,
    reach_m: float,
    kept: SafeSets | None,
) -> SafeSets:
    """Return all sets that agents with reserves from places to stops (n, 2) stay in."""
    sets = [
        separate_cells(places, stops, limits.body_radius_m, step_m),
        ground_sets(ground, places, stops, aims, limits.keep_m, reach_m),
    ]
    return joined(*sets, *([] if kept is None else [kept]))


def _inert_moves(
    ground: Ground,
    places: Floats,
    aims: Floats,
    limits: MoveLimits,
    share: Floats,
    horizon: int,
    velocities: Floats,
    kept: SafeSets | None,
    drifts: Floats,
) -> NetworkMoves:
    """Moves of double integrators at velocities (n, 2) to aims that drift (n, 2) in a step."""
    assert limits.acceleration_m_s2 is not None
    most = limits.speed_m_s * limits.time_step_s
    change = limits.acceleration_m_s2 * limits.time_step_s**2
    now = velocities * limits.time_step_s
    speed = np.linalg.norm(now, axis=1)
    if not _shorter(now, most).all():
        which = int(speed.argmax())
        raise InputError(f"agent {which} is faster than {limits.speed_m_s:g} m/s", key="velocities")
    stops = places + stopping_ways(now, change)
    fastest = np.minimum(speed + change, most)
    later = np.maximum(np.ceil(fastest / change - 1e-9), 1.0)
    inertia = Inertia(now, change, later.astype(np.intp))
    # A step and then the longest reserve; over the horizon that of the largest speed.
    step_m = fastest * (1.0 + 0.5 * later)
    reach_m = most * (horizon + 0.5 * math.ceil(most / change))
    sets = _sets(ground, places, stops, aims, limits, step_m, reach_m, kept)
    braking = _braking(places, now, change, horizon)
    wide = _widened(sets, np.concatenate((braking[0], _ends(*braking, inertia)), axis=1))
    wide = wide.thinned(places, np.full(len(places), reach_m))
    found = solve_programme(places, aims, share, horizon, most, wide, inertia, drifts)
    paths, ways = braking if found is None else found
    stopping = np.ones(len(places), dtype=np.bool_)
    slack = ROUNDING * ground.hull.radius_m
    first, way = braking[0][:, 1].copy(), braking[1][:, 1].copy()
    for blend in BLENDS if found is not None else ():
        tried = blend * paths[:, 1] + (1.0 - blend) * braking[0][:, 1]
        speeds = blend * ways[:, 1] + (1.0 - blend) * braking[1][:, 1]
        reserve = np.stack((places + 0.5 * now, tried, tried + stopping_ways(speeds, change)), 1)
        fine = stopping & sets.holds(reserve, slack) & _shorter(speeds, most)
        fine &= _shorter(speeds - now, change)
        first[fine], way[fine] = tried[fine], speeds[fine]
        stopping &= ~fine
    paths[:, 1], ways[:, 1] = first, way
    paths[stopping], ways[stopping] = braking[0][stopping], braking[1][stopping]
    return NetworkMoves(paths, ways / limits.time_step_s, None, stopping, len(places))


def stopping_ways(ways_m: Floats, change_m: float) -> Floats:
    """Return the ways ``(n, 2)`` on which double integrators brake straight to rest."""
    # Shapes: ways_m (n, 2).
    return 0.5 * _stop_steps(ways_m, change_m)[:, None] * ways_m


def _shorter(ways: Floats, most: float) -> NDArray[np.bool_]:
    """Return whether ways (n, 2) are at most that long, but for rounding; (n,)."""
    return np.linalg.norm(ways, axis=1) <= most * (1.0 + 1e-9)


def _stop_steps(ways: Floats, change: float) -> Floats:
    """Least number of steps in which velocities (n, 2) end; (n,)."""
    return np.ceil(np.linalg.norm(ways, axis=1) / change - 1e-9)


def _braking(places: Floats, now: Floats, change: float, horizon: int) -> tuple[Floats, Floats]:
    """Paths and velocities (n, N + 1, 2) of agents that brake straight and evenly."""
    steps = _stop_steps(now, change)[:, None]
    left = np.maximum(1.0 - np.arange(horizon + 1) / np.maximum(steps, 1.0), 0.0)
    ways = left[:, :, None] * now[:, None]
    paths = np.zeros_like(ways) + places[:, None]
    paths[:, 1:] += np.cumsum(0.5 * (ways[:, 1:] + ways[:, :-1]), axis=1)
    return paths, ways


def _ends(paths: Floats, ways: Floats, inertia: Inertia) -> Floats:
    """Ends (n, N + 1, 2) of the reserves that a programme keeps for paths."""
    return paths + 0.5 * inertia.stop_steps[:, None, None] * ways


def _widened(sets: SafeSets, places: Floats) -> SafeSets:
    """Sets that are just wide enough to hold places (n, j, 2) as well."""
    height = np.einsum("kjx,kx->kj", places[sets.agent], sets.normals).max(axis=1)
    away = np.linalg.norm(places[sets.disc_agent] - sets.centres_m[:, None], axis=2).max(axis=1)
    return SafeSets(
        sets.agent,
        sets.normals,
        np.maximum(sets.offsets_m, height),
        sets.disc_agent,
        sets.centres_m,
        np.maximum(sets.radii_m, away),
    )


def _driven(
    places: Floats, ends: Floats, headings: Floats, limits: MoveLimits
) -> tuple[Floats, Floats]:
    """Return places and headings of unicycles (n, 2) that turn toward ends (n, 2) and drive."""
    assert limits.turn_rate_rad_s is not None
    way = ends - places
    length = np.linalg.norm(way, axis=1)
    turn = np.arctan2(way[:, 1], way[:, 0]) - headings
    # Driving backwards needs no more than a quarter turn.
    turn -= np.pi * np.round(turn / np.pi)
    turn[length == 0.0] = 0.0
    most = limits.turn_rate_rad_s * limits.time_step_s
    left_s = limits.time_step_s - np.abs(turn) / limits.turn_rate_rad_s
    move = np.where(left_s > 0.0, np.minimum(length, limits.speed_m_s * left_s), 0.0)
    share = np.where(length > 0.0, move / np.where(length > 0.0, length, 1.0), 0.0)
    return places + share[:, None] * way, headings + np.clip(turn, -most, most)


def _checked(values: Floats, count: int, key: str) -> Floats:
    """Finite values (count, 2)."""
    found = np.asarray(values, dtype=np.float64)
    if found.shape != (count, 2) or not count or not np.isfinite(found).all():
        raise InputError(
            f"an array of shape {found.shape} with {int((~np.isfinite(found)).sum())} numbers that "
            "are not finite is given",
            key=key,
            remedy=f"give finite numbers of shape ({count}, 2)",
        )
    return found


@dataclass(frozen=True, eq=False)
class Motion:
    """Places, velocities and headings of agents."""

    places_m: NDArray[np.float64]  # (n, 2)
    velocities_m_s: NDArray[np.float64]  # (n, 2) velocities at the end of the last step
    headings_rad: NDArray[np.float64]  # (n,); they matter for unicycles alone


class Mover(Protocol):
    """The law by which agents move toward their targets in one step."""

    def __call__(
        self,
        ground: Ground,
        motion: Motion,
        targets_m: NDArray[np.float64],
        responds: NDArray[np.bool_],
        drifts_m_s: NDArray[np.float64],
    ) -> Motion:
        """Return where agents are after the step, and how they move then.

        Targets move at velocities `drifts_m_s` (n, 2) as far as agents have estimated that.
        """
        ...


@dataclass(frozen=True)
class LawMover:
    """Drives by the laws, with the speed clipped."""

    gains: Gains  # As for :func:`planopt.coverage.control.laws.law_moves`
    time_step_s: float
    speed_m_s: float | None

    def __call__(
        self,
        ground: Ground,
        motion: Motion,
        targets_m: NDArray[np.float64],
        responds: NDArray[np.bool_],
        drifts_m_s: NDArray[np.float64],
    ) -> Motion:
        """Return where agents are after a step of the laws."""
        here, gains = motion.places_m, self.gains
        moved = law_moves(here, targets_m, responds, gains, self.time_step_s, self.speed_m_s)
        return Motion(moved, (moved - here) / self.time_step_s, motion.headings_rad)


@dataclass(frozen=True)
class RecedingMover:
    """Plans over a horizon with the targets held, and drives the first move."""

    gains: Gains  # As for :func:`planopt.coverage.control.movers.plan_moves`
    limits: MoveLimits
    horizon: int
    # Links to base stations that agents keep over a tree; None for none
    radio: RadioLimits | None = None
    # Whether plans follow targets that move; else targets are held over the horizon
    lead: bool = False

    def __call__(
        self,
        ground: Ground,
        motion: Motion,
        targets_m: NDArray[np.float64],
        responds: NDArray[np.bool_],
        drifts_m_s: NDArray[np.float64],
    ) -> Motion:
        """Return where agents are after the first move of a plan."""
        step_s, kept = self.limits.time_step_s, None
        most = self.limits.acceleration_m_s2
        if self.radio is not None:
            stops = motion.places_m
            if most is not None:
                stops = stops + stopping_ways(motion.velocities_m_s * step_s, most * step_s**2)
            kept = radio_tree(motion.places_m, self.radio, stops).kept
        moves = plan_moves(
            ground,
            motion.places_m,
            targets_m,
            self.limits,
            self.gains.shares(responds, step_s) / step_s,
            self.horizon,
            velocities_m_s=motion.velocities_m_s,
            headings_rad=motion.headings_rad,
            kept=kept,
            target_velocities_m_s=drifts_m_s if self.lead else None,
        )
        if most is not None:
            velocities = moves.velocities_m_s[:, 1]
        else:
            velocities = (moves.next_m - motion.places_m) / step_s
        turned = motion.headings_rad if moves.headings_rad is None else moves.headings_rad
        return Motion(moves.next_m, velocities, turned)
