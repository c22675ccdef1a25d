"""Initial guesses for objectives that couple the positions of a path: a fan of paths.

All paths are extended together, step by step; a path turns aside at obstacles, according to a
raster of clearances. While path loss is uncertain, paths to the base station are added:
measurements next to it are most informative, and the fan may have no path near it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.planning.candidates import UNLIMITED, Budget
from planopt.planning.scene import Ground
from planopt.planning.search.lattice_search import steps_apart
from planopt.planning.search.local_ranking import (
    APART_STEPS,
    LocalRanking,
    can_climb,
    climb_paths,
    distinct,
    headings_and_speeds,
)
from planopt.planning.tolerances import CLEARANCE_PAD_M, CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, clearance_m, inside_bounds, segments_clear
from planopt.world.motion import paths_gap_m

CELLS_PER_STEP = 4.0  # Number of raster cells per longest step
MAX_CELLS = 250_000  # Maximum number of cells; a larger workspace gets a coarser raster


@dataclass(frozen=True, eq=False)
class RoughClearance:
    """Raster of clearances at the corners of square cells over the workspace."""

    origin_m: Floats  # (2,) of corner [0, 0]
    cell_m: float  # Side length of a cell
    distance_m: Floats  # (ny, nx) distance to the nearest obstacle
    bounds_m: tuple[float, float, float, float]  # (x_min, y_min, x_max, y_max)

    def is_free(self, places_m: Floats, clearance: float) -> Mask:
        """Return a mask of positions (..., 2) that are in bounds and roughly keep `clearance`."""
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
    """Return the raster of clearances of a problem's workspace."""
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


HEADINGS = 16  # Number of directions of the fan
TURNS_RAD = (0.0, 0.5, -0.5, 1.0, -1.0)
"""Total turns of the fan's paths as multiples of pi, spread evenly over the steps."""
ASIDE_RAD = tuple(
    side * turn for turn in (0.0, 0.4, 0.8, 1.2, 1.6, 2.2, 2.8) for side in (1.0, -1.0)
)[1:]
"""Turns to try at a blocked step, smallest first."""
SAMPLES = (0.5, 1.0)  # Positions along a step at which the raster is read, as fractions of the step


def fan_paths(
    context: StepContext, index: ObstacleIndex, rough: RoughClearance, horizon: int
) -> Floats:
    """Return the fan (c, N, 2) of collision-free paths at full speed."""
    heading, turn = (
        grid.ravel()
        for grid in np.meshgrid(
            2.0 * math.pi * np.arange(HEADINGS) / HEADINGS,
            math.pi * np.asarray(TURNS_RAD if horizon > 1 else TURNS_RAD[:1]) / max(horizon - 1, 1),
        )
    )
    turns = np.tile(turn, (horizon, 1))
    turns[0] = heading
    return driven_paths(context, index, rough, turns, np.ones(turns.shape))


def driven_paths(
    context: StepContext,
    index: ObstacleIndex,
    rough: RoughClearance,
    turn_rad: Floats,  # (N, c) before each step; the first is a heading
    speed: Floats,  # (N, c) relative to the maximum speed
) -> Floats:
    """Return paths ``(c, N, 2)`` that follow commands of turns and speeds around obstacles."""
    problem = context.problem
    clear = problem.constraints.clearance_m + CLEARANCE_PAD_M
    longest = problem.step_length_m - STEP_PAD_M
    shares = np.asarray(SAMPLES)[:, None]
    heading = np.cumsum(turn_rad, axis=0)
    moves = _direction(heading) * (longest * speed)[:, :, None]
    paths = np.empty((turn_rad.shape[1], len(turn_rad) + 1, 2))
    paths[:, 0] = context.position_m
    np.cumsum(moves.transpose(1, 0, 2), axis=1, out=paths[:, 1:])
    paths[:, 1:] += context.position_m
    places = paths[:, :-1, None] + moves.transpose(1, 0, 2)[:, :, None] * shares
    free = np.asarray(rough.is_free(places, clear).all(axis=2))
    for k in range(len(turn_rad) if len(context.moving) else 0):
        free[:, k] &= steps_apart(context.moving, k, paths[:, k], paths[:, k + 1])
    rest = np.flatnonzero(~free.all(axis=1))
    if len(rest):
        first = int(free[rest].argmin(axis=1).min())
        paths[rest] = _turned_aside(
            context, rough, paths[rest], heading[:, rest], speed[:, rest], first
        )
    return _stopped(context, index, rough, paths, clear)


def _turned_aside(
    context: StepContext,
    rough: RoughClearance,
    paths_m: Floats,
    heading_rad: Floats,  # (N, c) commanded
    speed: Floats,  # (N, c) commanded
    first: int,
) -> Floats:
    """Return the paths (c, N + 1, 2) with turns to avoid obstacles, from step `first` on."""
    problem = context.problem
    clear = problem.constraints.clearance_m + CLEARANCE_PAD_M
    longest = problem.step_length_m - STEP_PAD_M
    aside, shares = np.asarray(ASIDE_RAD), np.asarray(SAMPLES)[:, None]
    paths, turned = paths_m.copy(), np.zeros(len(paths_m))
    for k in range(first, len(speed)):
        heading = heading_rad[k] + turned
        step = longest * speed[k]
        ahead = _direction(heading) * step[:, None]
        paths[:, k + 1] = paths[:, k] + ahead
        places = paths[:, k, None] + ahead[:, None] * shares
        ahead_free = rough.is_free(places, clear).all(axis=1)
        ahead_free &= steps_apart(context.moving, k, paths[:, k], paths[:, k + 1])
        blocked = np.flatnonzero(~ahead_free)
        if not len(blocked):
            continue
        angles = heading[blocked, None] + aside
        moves = _direction(angles) * step[blocked, None, None]
        places = paths[blocked, k][:, None, None] + moves[:, :, None] * shares
        free = rough.is_free(places, clear).all(axis=2)
        begins = np.broadcast_to(paths[blocked, k][:, None], moves.shape)
        free &= steps_apart(context.moving, k, begins, begins + moves)
        chosen = free.argmax(axis=1)
        rows = np.arange(len(blocked))
        turned[blocked] += aside[chosen]
        paths[blocked, k + 1] = paths[blocked, k] + moves[rows, chosen]
    return paths


def _stopped(
    context: StepContext,
    index: ObstacleIndex,
    rough: RoughClearance,
    paths_m: Floats,
    clear_m: float,
) -> Floats:
    """Return the positions (c, N, 2) after each step, with a stop before any blocked step."""
    count, places = len(paths_m), int(paths_m.shape[1])
    starts, ends = paths_m[:, :-1].reshape(-1, 2), paths_m[:, 1:].reshape(-1, 2)
    free = inside_bounds(context.problem.workspace, ends)
    # The clearance at the midpoint covers the half steps around it; raster errors are below a cell.
    far = clear_m + 0.5 * context.problem.step_length_m + rough.cell_m
    near = free & ~rough.is_free(0.5 * (starts + ends), far)
    free[near] = segments_clear(index, starts[near], ends[near], clear_m)
    free = free.reshape(count, places - 1)
    # Number of free steps before the first blocked step.
    reached = np.logical_and.accumulate(free, axis=1).sum(axis=1, dtype=np.intp)
    until = np.minimum(np.arange(1, places, dtype=np.intp), reached[:, None])
    return paths_m[np.arange(count)[:, None], until]


def _direction(angle: Floats) -> Floats:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


ONWARD = 8  # Number of directions in which paths continue from the station
DETOURS = 2  # Maximum number of steps by which arcs to the station exceed the straight path
HALVINGS = 40  # Number of bisections for the curvature of an arc
Commands = tuple[Floats, Floats]
"""Commands of c paths: turns and relative speeds ``(N, c)`` of the steps."""


def commands_via(
    start_m: Floats, place_m: Floats, horizon: int, longest_m: float
) -> Commands | None:
    """Return commands that reach a position straight or in arcs, then continue or wait, or None."""
    # None if the position is not reachable within the horizon.
    # Shapes: start_m, place_m (2,).
    offset = (place_m - start_m) / longest_m
    chord, heading = float(np.hypot(*offset)), math.atan2(offset[1], offset[0])
    fewest = max(1, math.ceil(chord))
    if fewest > horizon:
        return None
    paths = [_onward(heading, 0.0, chord / fewest, fewest, horizon)]
    for steps in range(fewest + 1, min(fewest + DETOURS, horizon) + 1):
        bend = arc_turn(chord, steps)
        paths += [_onward(heading, side * bend, 1.0, steps, horizon) for side in (1.0, -1.0)]
    turns, speeds = zip(*paths, strict=True)
    return np.concatenate(turns, axis=1), np.concatenate(speeds, axis=1)


def arc_turn(chord: float, steps: int) -> float:
    """Return the turn per step in rad of an arc with `steps` unit steps and length `chord`."""
    # The chord sin(steps a / 2) / sin(a / 2) decreases from `steps` to 0.
    low, high = 0.0, 2.0 * math.pi / steps
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        far = math.sin(0.5 * steps * middle) > chord * math.sin(0.5 * middle)
        low, high = (middle, high) if far else (low, middle)
    return low


def _onward(heading: float, bend: float, speed: float, steps: int, horizon: int) -> Commands:
    """Return commands for an arc of `steps` steps, then for each onward direction or waiting."""
    paths = ONWARD + 1 if steps < horizon else 1
    turn, speeds = np.zeros((horizon, paths)), np.ones((horizon, paths))
    turn[0] = heading - 0.5 * bend * (steps - 1)
    turn[1:steps] = bend
    speeds[:steps] = speed
    if steps < horizon:
        turn[steps, :ONWARD] = 2.0 * math.pi * np.arange(ONWARD) / ONWARD
        speeds[steps:, ONWARD] = 0.0
    return turn, speeds


ELITE, ROUNDS_BENT, NARROWING = 8, 3, 0.6
"""Number of paths varied per round, number of rounds, factor on standard deviations per round."""
BENT, NUDGED, NUDGED_PLACES = 8, 6, 3.0
"""Number of bent and nudged copies of each path, and mean number of nudged positions per copy."""
BEND_RAD, NUDGE_SHARE = 0.8, 0.4
"""Initial standard deviations of a random turn, and of a random shift in longest steps."""
FIRST_SHARE, EVEN_SHARE, SPEED_SHARE = 0.5, 2.0, 0.5
"""Standard deviations of first heading, uniform turn and speed, relative to a bend's."""
SEED, RANKED = 0, 4
"""Seed of the random variations, the same at every step; number of returned paths."""


def varied_paths(
    start_m: Floats,  # (2,)
    paths_m: Floats,  # (c, N, 2)
    longest_m: float,
    drive: Callable[[Floats, Floats], Floats],
    value: Callable[[Floats], Floats],
    budget: Budget = UNLIMITED,
) -> Floats:
    """Return the best distinct paths after a few rounds of random bends and shifts of positions."""
    # If terms have no gradients, this finds maxima that the fan misses, such as short first steps.
    generator = np.random.default_rng(SEED)
    horizon, apart = int(paths_m.shape[1]), APART_STEPS * longest_m
    values = value(paths_m)
    kept = distinct(paths_m, values, apart, ELITE)
    paths, values = paths_m[kept], values[kept]
    for number in range(ROUNDS_BENT):
        if budget.searched:
            break
        width = NARROWING**number
        moved = _nudged(start_m, np.repeat(paths, NUDGED, axis=0), longest_m, width, generator)
        again = np.concatenate([np.repeat(paths, BENT, axis=0), moved])
        heading, speed = np.split(headings_and_speeds(start_m, again, longest_m).T, 2)
        turn = np.diff(heading, axis=0, prepend=0.0)
        count = BENT * len(paths)
        turn[:, :count] += _bends(horizon, count, BEND_RAD * width, generator)
        speed[:, :count] *= 1.0 + SPEED_SHARE * width * generator.normal(size=(1, count))
        np.clip(speed, 0.0, 1.0, out=speed)
        varied = drive(turn, speed)
        paths, values = np.concatenate([paths, varied]), np.concatenate([values, value(varied)])
        kept = distinct(paths, values, apart, ELITE)
        paths, values = paths[kept], values[kept]
    return paths[:RANKED]


def _nudged(
    start_m: Floats, paths_m: Floats, longest_m: float, width: float, generator: np.random.Generator
) -> Floats:
    """Return paths (c, N, 2) with some positions shifted at random, within the step limit."""
    count, horizon = len(paths_m), int(paths_m.shape[1])
    nudge = NUDGE_SHARE * width * longest_m * generator.normal(size=paths_m.shape)
    moves = generator.random((count, horizon, 1)) < NUDGED_PLACES / horizon
    wanted = paths_m + moves * nudge
    found = np.empty_like(paths_m)
    here = np.broadcast_to(start_m, (count, 2))
    for k in range(horizon):
        leg = wanted[:, k] - here
        length = np.hypot(leg[:, 0], leg[:, 1])
        here = here + leg * np.minimum(1.0, longest_m / np.maximum(length, longest_m))[:, None]
        found[:, k] = here
    return found


def _bends(horizon: int, count: int, width_rad: float, generator: np.random.Generator) -> Floats:
    """Return random turns (N, c): at the start, evenly over later steps, and at one random step."""
    turn = np.zeros((horizon, count))
    turn[0] = FIRST_SHARE * width_rad * generator.normal(size=count)
    if horizon > 1:
        turn[1:] += EVEN_SHARE * width_rad * generator.normal(size=count) / (horizon - 1)
        at = generator.integers(1, horizon, count)
        turn[at, np.arange(count)] += width_rad * generator.normal(size=count)
    return turn


CLIMBING = 12  # Number of paths that enter gradient ascent
ROUNDS, FOLLOWED = (3, 3, 4), (6, 3, 3)
"""Number of ascent steps in each round, and number of paths kept after each round."""


class FanGuesses:
    """Search for initial guesses of one robot; it caches the raster of clearances."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        self._index = ground.index
        self._rough = rough_clearance(problem, ground.index)

    def find_paths(
        self, context: StepContext, known_m: list[Floats], budget: Budget = UNLIMITED
    ) -> list[Floats]:
        """Return the best distinct paths (N, 2), ordered by local ranking."""
        fan = fan_paths(context, self._index, self._rough, self._problem.planner.horizon)
        longest = self._problem.step_length_m - STEP_PAD_M
        climbs = can_climb(self._problem)

        def drive(turn: Floats, speed: Floats) -> Floats:
            return driven_paths(context, self._index, self._rough, turn, speed)

        paths = np.concatenate([np.asarray(known_m).reshape(-1, *fan.shape[1:]), fan])
        if climbs and not context.posterior.theta_known:
            station = np.asarray(context.posterior.parameters.station.position_m)
            via = commands_via(context.position_m, station, int(fan.shape[1]), longest)
            paths = paths if via is None else np.concatenate([paths, drive(*via)])
        ranking = LocalRanking(context, paths)
        apart = APART_STEPS * longest
        if not climbs:
            found = varied_paths(
                context.position_m,
                paths,
                longest,
                drive,
                lambda moved_m: self._if_apart(context, moved_m, ranking(moved_m)),
                budget,
            )
            return list(found)
        values = self._if_apart(context, paths, ranking(paths))
        best = paths[distinct(paths, values, apart, CLIMBING)]

        def slopes(moved_m: Floats) -> tuple[Floats, Floats]:
            value, slope = ranking.slopes(moved_m)
            return self._if_apart(context, moved_m, value), slope

        found, _ = climb_paths(
            context.position_m, best, longest, drive, slopes, ROUNDS, FOLLOWED, apart, budget
        )
        return list(found)

    def _if_apart(self, context: StepContext, paths_m: Floats, values: Floats) -> Floats:
        """Return `values` of paths (c, N, 2), or -inf for paths too close to moving obstacles."""
        begin = np.broadcast_to(context.position_m, (len(paths_m), 1, 2))
        whole = np.concatenate([begin, paths_m], axis=1)
        is_apart = paths_gap_m(context.moving, whole) >= -CLEARANCE_TOLERANCE_M
        return np.where(is_apart, values, -np.inf)
