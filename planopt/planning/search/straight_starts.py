"""Straight and bent ways in all directions: starts for objectives that no lattice search adds up.

All ways are driven at once. Where the next step of one is about to leave the free space it turns
aside as little as needed and goes on from there, along a wall or out of a corner. Afterwards every
segment is checked exactly, and a way stands still from where it would not be clear. Of what moves,
steps keep clear as long as there is a way aside.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.planning.search.moving_moves import steps_apart
from planopt.planning.search.rough_clearance import RoughClearance
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.planning.worth.situation import Situation
from planopt.world.clearance import ObstacleIndex, inside_bounds, segments_clear

HEADINGS = 16
"""Directions of the fan."""

TURNS_RAD = (0.0, 0.5, -0.5, 1.0, -1.0)
"""How far a way turns in all, in units of pi, evenly over its steps."""

ASIDE_RAD = tuple(
    side * turn for turn in (0.0, 0.4, 0.8, 1.2, 1.6, 2.2, 2.8) for side in (1.0, -1.0)
)[1:]
"""Ways out where the way ahead is not free, the smallest first."""

SAMPLES = (0.5, 1.0)
"""Where on a step the raster is looked up, as shares of it."""


def straight_starts(
    situation: Situation, index: ObstacleIndex, rough: RoughClearance, horizon: int
) -> NDArray[np.float64]:
    """Ways (c, N, 2) at full speed, every one of them free.

    Parameters
    ----------
    situation
        Where the robot is, and its limits.
    index
        The obstacles.
    rough
        A raster of distances to them.
    horizon
        N.
    """
    heading, turn = (
        grid.ravel()
        for grid in np.meshgrid(
            2.0 * math.pi * np.arange(HEADINGS) / HEADINGS,
            math.pi * np.asarray(TURNS_RAD if horizon > 1 else TURNS_RAD[:1]) / max(horizon - 1, 1),
        )
    )
    turns = np.tile(turn, (horizon, 1))
    turns[0] = heading
    return driven_ways(situation, index, rough, turns, np.ones(turns.shape))


def driven_ways(
    situation: Situation,
    index: ObstacleIndex,
    rough: RoughClearance,
    turn_rad: NDArray[np.float64],
    speed: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Drive c ways at once; ``(c, N, 2)``.

    Parameters
    ----------
    situation, index, rough
        As in :func:`straight_starts`.
    turn_rad
        ``(N, c)`` before each step, the first one from the x axis.
    speed
        ``(N, c)`` as a share of the largest.
    """
    problem = situation.problem
    clear = problem.constraints.clearance_m + CLEARANCE_PAD_M
    longest = problem.step_length_m - STEP_PAD_M
    shares = np.asarray(SAMPLES)[:, None]
    heading = np.cumsum(turn_rad, axis=0)
    moves = _direction(heading) * (longest * speed)[:, :, None]
    ways = np.empty((turn_rad.shape[1], len(turn_rad) + 1, 2))
    ways[:, 0] = situation.position_m
    np.cumsum(moves.transpose(1, 0, 2), axis=1, out=ways[:, 1:])
    ways[:, 1:] += situation.position_m
    places = ways[:, :-1, None] + moves.transpose(1, 0, 2)[:, :, None] * shares
    free = np.asarray(rough.is_free(places, clear).all(axis=2))
    for k in range(len(turn_rad) if len(situation.circumstances.moving) else 0):
        free[:, k] &= steps_apart(situation.circumstances.moving, k, ways[:, k], ways[:, k + 1])
    rest = np.flatnonzero(~free.all(axis=1))
    if len(rest):
        first = int(free[rest].argmin(axis=1).min())
        ways[rest] = _turned_aside(
            situation, rough, ways[rest], heading[:, rest], speed[:, rest], first
        )
    return _stopped(situation, index, rough, ways, clear)


def _turned_aside(
    situation: Situation,
    rough: RoughClearance,
    ways_m: NDArray[np.float64],
    heading_rad: NDArray[np.float64],
    speed: NDArray[np.float64],
    first: int,
) -> NDArray[np.float64]:
    """The ways (c, N + 1, 2), turned aside where they are not free; until step `first` they are.

    `heading_rad` and `speed` (N, c) are those commanded.
    """
    problem = situation.problem
    clear = problem.constraints.clearance_m + CLEARANCE_PAD_M
    longest = problem.step_length_m - STEP_PAD_M
    aside, shares = np.asarray(ASIDE_RAD), np.asarray(SAMPLES)[:, None]
    ways, turned = ways_m.copy(), np.zeros(len(ways_m))
    for k in range(first, len(speed)):
        heading = heading_rad[k] + turned
        step = longest * speed[k]
        ahead = _direction(heading) * step[:, None]
        ways[:, k + 1] = ways[:, k] + ahead
        places = ways[:, k, None] + ahead[:, None] * shares
        ahead_free = rough.is_free(places, clear).all(axis=1)
        ahead_free &= steps_apart(situation.circumstances.moving, k, ways[:, k], ways[:, k + 1])
        blocked = np.flatnonzero(~ahead_free)
        if not len(blocked):
            continue
        angles = heading[blocked, None] + aside
        moves = _direction(angles) * step[blocked, None, None]
        places = ways[blocked, k][:, None, None] + moves[:, :, None] * shares
        free = rough.is_free(places, clear).all(axis=2)
        begins = np.broadcast_to(ways[blocked, k][:, None], moves.shape)
        free &= steps_apart(situation.circumstances.moving, k, begins, begins + moves)
        chosen = free.argmax(axis=1)
        rows = np.arange(len(blocked))
        turned[blocked] += aside[chosen]
        ways[blocked, k + 1] = ways[blocked, k] + moves[rows, chosen]
    return ways


def _stopped(
    situation: Situation,
    index: ObstacleIndex,
    rough: RoughClearance,
    ways_m: NDArray[np.float64],
    clear_m: float,
) -> NDArray[np.float64]:
    """The ways (c, N + 1, 2) without their first place, standing from where they are not free."""
    count, places = len(ways_m), int(ways_m.shape[1])
    starts, ends = ways_m[:, :-1].reshape(-1, 2), ways_m[:, 1:].reshape(-1, 2)
    free = inside_bounds(situation.problem.workspace, ends)
    # No place of a step is farther from its middle than half of it, nor the raster off by a cell.
    far = clear_m + 0.5 * situation.problem.step_length_m + rough.cell_m
    near = free & ~rough.is_free(0.5 * (starts + ends), far)
    free[near] = segments_clear(index, starts[near], ends[near], clear_m)
    free = free.reshape(count, places - 1)
    # The first step that is not free: until then all of them were.
    reached = np.logical_and.accumulate(free, axis=1).sum(axis=1, dtype=np.intp)
    until = np.minimum(np.arange(1, places, dtype=np.intp), reached[:, None])
    return ways_m[np.arange(count)[:, None], until]


def _direction(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
