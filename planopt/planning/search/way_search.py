"""Bend the best of many ways further, all at once: where no dynamic programming applies.

Objectives that couple the places of a way have several maxima that no stand-in tells apart. So the
best ways, told apart by where they lead, are bent at random in a few rounds; what is valued is the
objective itself, batched. Directions are drawn anew in each round, narrower each time, from one
generator, so that the same seed finds the same ways.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.planning.budget import UNLIMITED, Budget

ELITE = 8
"""Ways that are bent in a round."""

BENT, NUDGED = 8, 6
"""Ways that each is bent into, and ways that have its places nudged."""

ROUNDS = 3
"""How often."""

BEND_RAD = 0.8
"""Deviation of a bend in the first round; each later one has `NARROWING` times that."""

NUDGE_SHARE = 0.4
"""Deviation of a nudge in the first round, as a share of the longest step."""

NARROWING = 0.6

NUDGED_PLACES = 3.0
"""Places of a way that are nudged at once, on average."""

FIRST_SHARE, EVEN_SHARE, SPEED_SHARE = 0.5, 2.0, 0.5
"""Deviations of the first heading, of the turn spread over a whole way, and of the change of its
speed (as a share), in units of that of a bend at one step."""

APART_STEPS = 0.5
"""Ways that are nowhere farther apart than this many longest steps count as one."""

Drive = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""From turns and speeds (N, c) to ways (c, N, 2)."""

Value = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From ways (c, N, 2) to their worths (c,)."""


def search_ways(
    start_m: NDArray[np.float64],
    ways_m: NDArray[np.float64],
    longest_m: float,
    drive: Drive,
    value: Value,
    generator: np.random.Generator,
    budget: Budget = UNLIMITED,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Improve on `ways_m` (c, N, 2); the best ways, told apart, and their worths, best first.

    Parameters
    ----------
    start_m
        ``(2,)`` where all begin.
    ways_m
        Ways to begin with.
    longest_m
        Longest step.
    drive, value
        See their types.
    generator
        Draws the bends.
    budget
        Until when rounds begin.
    """
    horizon = int(ways_m.shape[1])
    apart = APART_STEPS * longest_m
    worths = value(ways_m)
    kept = distinct(ways_m, worths, apart, ELITE)
    ways, worths = ways_m[kept], worths[kept]
    for number in range(ROUNDS):
        if budget.searched:
            break
        width = NARROWING**number
        moved = nudged(start_m, np.repeat(ways, NUDGED, axis=0), longest_m, width, generator)
        again = np.concatenate([np.repeat(ways, BENT, axis=0), moved])
        turn, speed = commands_of(start_m, again, longest_m)
        count = BENT * len(ways)
        turn[:, :count] += bends(horizon, count, BEND_RAD * width, generator)
        speed[:, :count] *= 1.0 + SPEED_SHARE * width * generator.normal(size=(1, count))
        np.clip(speed, 0.0, 1.0, out=speed)
        bent = drive(turn, speed)
        ways = np.concatenate([ways, bent])
        worths = np.concatenate([worths, value(bent)])
        kept = distinct(ways, worths, apart, ELITE)
        ways, worths = ways[kept], worths[kept]
    return ways, worths


def nudged(
    start_m: NDArray[np.float64],
    ways_m: NDArray[np.float64],
    longest_m: float,
    width: float,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Ways (c, N, 2) whose places are moved one by one, as little as steps allow after that."""
    count, horizon = len(ways_m), int(ways_m.shape[1])
    nudge = NUDGE_SHARE * width * longest_m * generator.normal(size=ways_m.shape)
    # Of a long way a few places at a time.
    moves = generator.random((count, horizon, 1)) < NUDGED_PLACES / horizon
    wanted = ways_m + moves * nudge
    found = np.empty_like(ways_m)
    here = np.broadcast_to(start_m, (count, 2))
    for k in range(horizon):
        leg = wanted[:, k] - here
        length = np.hypot(leg[:, 0], leg[:, 1])
        here = here + leg * np.minimum(1.0, longest_m / np.maximum(length, longest_m))[:, None]
        found[:, k] = here
    return found


def bends(
    horizon: int, count: int, width_rad: float, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Turns (N, c): of the whole way, evenly, and at one step of it."""
    turn = np.zeros((horizon, count))
    turn[0] = FIRST_SHARE * width_rad * generator.normal(size=count)
    if horizon > 1:
        turn[1:] += EVEN_SHARE * width_rad * generator.normal(size=count) / (horizon - 1)
        at = generator.integers(1, horizon, count)
        turn[at, np.arange(count)] += width_rad * generator.normal(size=count)
    return turn


def commands_of(
    start_m: NDArray[np.float64], ways_m: NDArray[np.float64], longest_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Turns and speeds ``(N, c)`` that drive the ways (c, N, 2)."""
    begin = np.broadcast_to(start_m, (len(ways_m), 1, 2))
    legs = np.diff(np.concatenate([begin, ways_m], axis=1), axis=1)
    length = np.hypot(legs[:, :, 0], legs[:, :, 1])
    heading = np.arctan2(legs[:, :, 1], legs[:, :, 0])
    # A step that stands still goes on in the last direction.
    moved = (length > 0.0) * np.arange(int(ways_m.shape[1]))
    last = np.maximum.accumulate(moved, axis=1)
    heading = np.take_along_axis(heading, last, axis=1)
    turn = np.diff(heading, axis=1, prepend=0.0)
    turn = (turn + math.pi) % (2.0 * math.pi) - math.pi
    return turn.T.copy(), np.minimum(length / longest_m, 1.0).T.copy()


def distinct(
    ways_m: NDArray[np.float64], worths: NDArray[np.float64], apart_m: float, count: int
) -> NDArray[np.intp]:
    """Numbers of up to `count` ways, best first, none nearer than `apart_m` to a better one."""
    kept: list[int] = []
    left = np.argsort(-worths, kind="stable")
    while len(left) and len(kept) < count:
        best = int(left[0])
        kept.append(best)
        gap = np.abs(ways_m[left] - ways_m[best]).max(axis=(1, 2))
        left = left[gap > apart_m]
    return np.asarray(kept, dtype=np.intp)
