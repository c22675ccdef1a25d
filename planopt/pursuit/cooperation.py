"""Cooperation of pursuers of one evader: each blocks directions that the others leave open.

The evader is in the set of positions consistent with the last records of all pursuers. Each
pursuer chooses, among points around that set, the aim that minimises the worst and the mean time to
capture over straight flights from these positions, given the aims of the others (equation 8.20).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats
from planopt.pursuit.arena import Arena
from planopt.pursuit.service import Record

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


@dataclass(frozen=True, eq=False)
class Hunt:
    """Inputs to the decision of a cooperating pursuer."""

    place_m: Floats  # (2,)
    speed_m_s: float
    mates: Sequence[Mate]
    evader_speed_m_s: float
    capture_radius_m: float
    arena: Arena


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


def blocking_aim_m(hunt: Hunt, centre_m: Floats, places_m: Floats, horizon_s: float) -> Floats:
    """Return the aim with the least time to capture, given the aims of the other pursuers."""
    turn = np.arange(FLIGHTS) * (2.0 * np.pi / FLIGHTS)
    velocity = hunt.evader_speed_m_s * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ahead_s = min(horizon_s, float(np.linalg.norm(centre_m - hunt.place_m)) / hunt.speed_m_s)
    flown_m = places_m[:, None] + ahead_s * velocity
    others_s = np.full(flown_m.shape[:2], np.inf)
    for mate in hunt.mates:
        there_m = _driven_m(hunt.arena, mate.place_m, mate.aim_m[None], mate.speed_m_s * ahead_s)
        found_s = _capture_s(hunt, there_m, mate.speed_m_s, flown_m, velocity)
        others_s = np.minimum(others_s, found_s[0])
    aims_m = _candidates_m(hunt, centre_m, ahead_s)
    there_m = _driven_m(hunt.arena, hunt.place_m, aims_m, hunt.speed_m_s * ahead_s)
    own_s = _capture_s(hunt, there_m, hunt.speed_m_s, flown_m, velocity)
    # The evader flees in the direction of latest capture; its position in the set is unknown.
    soonest_s = np.minimum(own_s, others_s)
    # The mean decides if two pursuers cannot shorten the worst flight. The centre wins ties.
    value_s = np.asarray((soonest_s.max(axis=2) + soonest_s.mean(axis=2)).mean(axis=1))
    return aims_m[int(value_s.round(6).argmin())]


def _candidates_m(hunt: Hunt, centre_m: Floats, ahead_s: float) -> Floats:
    """Return candidate aims (k, 2): the centre of the set, and positions on rings around it."""
    turn = np.arange(BEARINGS) * (2.0 * np.pi / BEARINGS)
    ring = hunt.evader_speed_m_s * ahead_s * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    aims_m = hunt.arena.within(centre_m + np.concatenate([share * ring for share in RINGS]))
    if hunt.arena.obstacles is not None:
        aims_m = aims_m[[hunt.arena.is_free(each, 1.1) for each in aims_m]]
    return np.concatenate([hunt.arena.free_m(centre_m)[None], aims_m.reshape(-1, 2)])


def _driven_m(arena: Arena, place_m: Floats, aims_m: Floats, range_m: float) -> Floats:
    """Return the positions (k, 2) after a drive towards aims, approximated on straight lines."""
    lengths_m = np.maximum(arena.distances_m(place_m, aims_m), 1e-9)
    return place_m + np.minimum(1.0, range_m / lengths_m)[:, None] * (aims_m - place_m)


def _capture_s(
    hunt: Hunt, pursuers_m: Floats, speed_m_s: float, evaders_m: Floats, velocity: Floats
) -> Floats:
    """Return the times for pursuers to capture evaders that flee along straight lines."""
    # The root s of |apart + velocity s| = speed s + radius.
    apart = evaders_m - pursuers_m[:, None, None]
    radius_m = hunt.capture_radius_m
    square = speed_m_s**2 - hunt.evader_speed_m_s**2
    half = speed_m_s * radius_m - (apart * velocity).sum(axis=-1)
    over = (apart * apart).sum(axis=-1) - radius_m**2
    if square <= 0.0:
        return np.sqrt(np.maximum(over, 0.0)) / speed_m_s
    root = (-half + np.sqrt(np.maximum(half * half + square * over, 0.0))) / square
    return np.where(over <= 0.0, 0.0, root)
