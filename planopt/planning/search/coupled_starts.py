"""Starts where the places of a way belong together: a fan of ways, the best of which climb.

Terms whose slopes are not known batched are bent at random instead.

Straight and bent ways in all directions: starts for objectives that no lattice search adds up.

All ways are driven at once. Where the next step of one is about to leave the free space it turns
aside as little as needed and goes on from there, along a wall or out of a corner. Afterwards every
segment is checked exactly, and a way stands still from where it would not be clear. Of what moves,
steps keep clear as long as there is a way aside.

Ways by the station: there path loss changes most, within a step, where no fan happens to lead.

A measurement beside the station tells far more of path loss than any other, and path loss is least
known there, so that what is learnt or mapped has a narrow maximum at it. A way that comes within a
step of it need not end there when it is refined.

About how far places are from obstacles and borders: a raster that is looked up, not searched.

For steering many ways at once, where exact distances would cost more than all the rest. What comes
out is checked exactly afterwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.candidates import UNLIMITED, Budget
from planopt.planning.scene import Ground
from planopt.planning.search.local_ranking import LocalRanking, can_climb
from planopt.planning.search.moving_moves import steps_apart
from planopt.planning.search.way_search import APART_STEPS, climb_ways, distinct, search_ways
from planopt.planning.tolerances import CLEARANCE_PAD_M, CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, clearance_m, inside_bounds, segments_clear
from planopt.world.moving_discs import paths_gap_m

CELLS_PER_STEP = 4.0
"""Cells of the raster along a longest step."""

MAX_CELLS = 250_000
"""A raster of more would be coarser instead."""


@dataclass(frozen=True, eq=False)
class RoughClearance:
    """Distances at the corners of square cells over the workspace."""

    origin_m: NDArray[np.float64]  # (2,) of corner [0, 0]
    cell_m: float  # Side of a cell
    distance_m: NDArray[np.float64]  # (ny, nx) to the nearest obstacle, none farther than `far_m`
    bounds_m: tuple[float, float, float, float]  # (x_min, y_min, x_max, y_max)

    def is_free(self, places_m: NDArray[np.float64], clearance: float) -> NDArray[np.bool_]:
        """Return whether places (..., 2) are in bounds and about `clearance` from obstacles."""
        x_min, y_min, x_max, y_max = self.bounds_m
        x, y = places_m[..., 0], places_m[..., 1]
        inside = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)
        ny, nx = self.distance_m.shape
        across = np.clip((x - self.origin_m[0]) / self.cell_m, 0.0, nx - 1.000001)
        up = np.clip((y - self.origin_m[1]) / self.cell_m, 0.0, ny - 1.000001)
        column, row = across.astype(np.intp), up.astype(np.intp)
        u, v = across - column, up - row
        d, at = self.distance_m.ravel(), row * nx + column
        below = (1.0 - u) * d[at] + u * d[at + 1]
        above = (1.0 - u) * d[at + nx] + u * d[at + nx + 1]
        return inside & ((1.0 - v) * below + v * above >= clearance)


def rough_clearance(problem: Problem, index: ObstacleIndex) -> RoughClearance:
    """Measure the corners of all cells once."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    width, height = x_max - x_min, y_max - y_min
    cell = max(problem.step_length_m / CELLS_PER_STEP, math.sqrt(width * height / MAX_CELLS))
    nx, ny = math.ceil(width / cell) + 2, math.ceil(height / cell) + 2
    corners = np.empty((ny, nx, 2))
    corners[..., 0] = x_min + cell * np.arange(nx)
    corners[..., 1] = y_min + cell * np.arange(ny)[:, None]
    far = width + height
    distance = np.minimum(clearance_m(index, corners.reshape(-1, 2)), far).reshape(ny, nx)
    return RoughClearance(np.array([x_min, y_min]), cell, distance, problem.workspace.bounds_m)


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
    situation: StepContext, index: ObstacleIndex, rough: RoughClearance, horizon: int
) -> NDArray[np.float64]:
    """Ways (c, N, 2) at full speed, every one of them free."""
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
    situation: StepContext,
    index: ObstacleIndex,
    rough: RoughClearance,
    turn_rad: NDArray[np.float64],  # (N, c) before each step, the first one from the x axis
    speed: NDArray[np.float64],  # (N, c) as a share of the largest
) -> NDArray[np.float64]:
    """Drive c ways at once; ``(c, N, 2)``."""
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
    for k in range(len(turn_rad) if len(situation.moving) else 0):
        free[:, k] &= steps_apart(situation.moving, k, ways[:, k], ways[:, k + 1])
    rest = np.flatnonzero(~free.all(axis=1))
    if len(rest):
        first = int(free[rest].argmin(axis=1).min())
        ways[rest] = _turned_aside(
            situation, rough, ways[rest], heading[:, rest], speed[:, rest], first
        )
    return _stopped(situation, index, rough, ways, clear)


def _turned_aside(
    situation: StepContext,
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
        ahead_free &= steps_apart(situation.moving, k, ways[:, k], ways[:, k + 1])
        blocked = np.flatnonzero(~ahead_free)
        if not len(blocked):
            continue
        angles = heading[blocked, None] + aside
        moves = _direction(angles) * step[blocked, None, None]
        places = ways[blocked, k][:, None, None] + moves[:, :, None] * shares
        free = rough.is_free(places, clear).all(axis=2)
        begins = np.broadcast_to(ways[blocked, k][:, None], moves.shape)
        free &= steps_apart(situation.moving, k, begins, begins + moves)
        chosen = free.argmax(axis=1)
        rows = np.arange(len(blocked))
        turned[blocked] += aside[chosen]
        ways[blocked, k + 1] = ways[blocked, k] + moves[rows, chosen]
    return ways


def _stopped(
    situation: StepContext,
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


ONWARD = 8
"""Directions in which ways go on from there."""

DETOURS = 2
"""Ways there take so many steps more than need be, at most: arcs, to either side."""

HALVINGS = 40
"""Bisections of the bend of an arc."""

Commands = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Turns and speeds ``(N, c)``."""


def commands_via(
    start_m: NDArray[np.float64], place_m: NDArray[np.float64], horizon: int, longest_m: float
) -> Commands | None:
    """Ways to a place, straight or in an arc, from there on in all directions or waiting.

    None where it is out of reach.
    """
    # Shapes: start_m, place_m (2,).
    offset = (place_m - start_m) / longest_m
    chord, heading = float(np.hypot(*offset)), math.atan2(offset[1], offset[0])
    fewest = max(1, math.ceil(chord))
    if fewest > horizon:
        return None
    ways = [_onward(heading, 0.0, chord / fewest, fewest, horizon)]
    for steps in range(fewest + 1, min(fewest + DETOURS, horizon) + 1):
        bend = arc_turn(chord, steps)
        ways += [_onward(heading, side * bend, 1.0, steps, horizon) for side in (1.0, -1.0)]
    turns, speeds = zip(*ways, strict=True)
    return np.concatenate(turns, axis=1), np.concatenate(speeds, axis=1)


def arc_turn(chord: float, steps: int) -> float:
    """The turn before each but the first of `steps` unit steps whose ends are `chord` apart.

    ``chord = sin(steps a / 2) / sin(a / 2)``, which falls from `steps` to 0 as a grows from 0 to
    that of a closed polygon.
    """
    low, high = 0.0, 2.0 * math.pi / steps
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        far = math.sin(0.5 * steps * middle) > chord * math.sin(0.5 * middle)
        low, high = (middle, high) if far else (low, middle)
    return low


def _onward(heading: float, bend: float, speed: float, steps: int, horizon: int) -> Commands:
    """There in `steps` steps of a speed, `heading` that of the chord; then on, or waiting."""
    ways = ONWARD + 1 if steps < horizon else 1
    turn, speeds = np.zeros((horizon, ways)), np.ones((horizon, ways))
    turn[0] = heading - 0.5 * bend * (steps - 1)
    turn[1:steps] = bend
    speeds[:steps] = speed
    if steps < horizon:
        turn[steps, :ONWARD] = 2.0 * math.pi * np.arange(ONWARD) / ONWARD
        speeds[steps:, ONWARD] = 0.0
    return turn, speeds


SEED = 0
"""Every search begins anew from it: the same situation has the same starts."""

VALUED = 4
"""Ways that are handed on of those bent, to be valued by all measurements."""

CLIMBING = 12
"""Ways that climb at first."""

ROUNDS, FOLLOWED = (3, 3, 4), (6, 3, 3)
"""After so many steps of the climb each, so many ways are followed on."""


class CoupledStarts:
    """Finds ways for one robot of a problem; keeps its raster of distances."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        self._index = ground.index
        self._rough = rough_clearance(problem, ground.index)

    def find_ways(
        self,
        situation: StepContext,
        known_m: list[NDArray[np.float64]],
        budget: Budget = UNLIMITED,
    ) -> list[NDArray[np.float64]]:
        """The best ways (N, 2), told apart, best first by what is measured near them."""
        fan = straight_starts(situation, self._index, self._rough, self._problem.planner.horizon)
        longest = self._problem.step_length_m - STEP_PAD_M

        def drive(turn: NDArray[np.float64], speed: NDArray[np.float64]) -> NDArray[np.float64]:
            return driven_ways(situation, self._index, self._rough, turn, speed)

        ways = np.concatenate([np.asarray(known_m).reshape(-1, *fan.shape[1:]), fan])
        if can_climb(self._problem) and not situation.posterior.theta_known:
            station = np.asarray(situation.posterior.parameters.station.position_m)
            via = commands_via(situation.position_m, station, int(fan.shape[1]), longest)
            ways = ways if via is None else np.concatenate([ways, drive(*via)])
        ranking = LocalRanking(situation, ways)

        def value(ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.where(self._is_apart(situation, ways_m), ranking(ways_m), -np.inf)

        if not can_climb(self._problem):
            generator = np.random.default_rng(SEED)
            found, _ = search_ways(
                situation.position_m, ways, longest, drive, value, generator, budget
            )
            return list(found[:VALUED])
        apart = APART_STEPS * longest
        best = ways[distinct(ways, value(ways), apart, CLIMBING)]

        def slopes(ways_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            worth, slope = ranking.slopes(ways_m)
            return np.where(self._is_apart(situation, ways_m), worth, -np.inf), slope

        found, _ = climb_ways(
            situation.position_m, best, longest, drive, slopes, ROUNDS, FOLLOWED, apart, budget
        )
        return list(found)

    def _is_apart(self, situation: StepContext, ways_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether ways (c, N, 2) keep from all that moves; ``(c,)``."""
        begin = np.broadcast_to(situation.position_m, (len(ways_m), 1, 2))
        whole = np.concatenate([begin, ways_m], axis=1)
        return paths_gap_m(situation.moving, whole) >= -CLEARANCE_TOLERANCE_M
