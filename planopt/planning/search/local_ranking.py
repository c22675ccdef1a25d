"""Ranking and batched ascent of many paths, with a shared set of measurements near all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.kriging import LocalChannel, LocalGrid
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.path_derivatives import LocalPaths
from planopt.objectives.terms.term import Paths, Term
from planopt.parts import calling, returned
from planopt.planning.candidates import UNLIMITED, Budget
from planopt.planning.values.context import StepContext, region_along
from planopt.planning.values.objective_value import missing, missing_slope
from planopt.problems.problem import Problem

ANCHORS, REGION_ANCHORS = 24, 64
"""Numbers of path positions and map positions near which measurements are selected."""
LEAST_NEIGHBOURS, STEP_NEIGHBOURS, MOST_NEIGHBOURS = 96, 16, 256
"""Number of measurements shared by all paths: minimum, increment per step, maximum."""
MAPPED_NEIGHBOURS = 384
"""Number of shared measurements for map averages; 256 are too few for 20 steps."""
RANKED_PLACES, CLIMBED_PLACES = 300, 1000
"""Approximate number of map positions evaluated for ranking, and for gradient ascent."""
MISSING_DB_SHARE = 10.0
"""Cost per dB of constraint violation, relative to the largest value in the first batch."""


def can_climb(problem: Problem) -> bool:
    """Return whether :meth:`LocalRanking.slopes` supports all terms of a problem."""
    return all(type(term).slope is not Term.slope for term in problem.terms)


@dataclass(frozen=True, eq=False)
class _Station:
    """Local channel model of one station, with map grids for gradient ascent and for ranking."""

    channel: LocalChannel
    fine: LocalGrid | None
    coarse: LocalGrid | None


class LocalRanking:
    """Approximate objective values of many paths in one step context."""

    def __init__(self, context: StepContext, about_m: Floats) -> None:
        self._context = context
        most = MAPPED_NEIGHBOURS if _averages_map(context.problem) else MOST_NEIGHBOURS
        count = min(LEAST_NEIGHBOURS + STEP_NEIGHBOURS * int(about_m.shape[1]), most)
        anchors = _anchors(about_m, ANCHORS)
        self._missing_db_cost: float | None = None
        self._measures = any(term.is_measured for term in context.problem.terms)

        def near(posterior: ChannelPosterior) -> _Station:
            channel = LocalChannel.around(posterior, anchors, count)
            fine = self._grid(channel, _anchors(about_m, REGION_ANCHORS))
            coarse = None if fine is None else _thinned(fine)
            return _Station(channel, fine, coarse)

        self._expected = [near(posterior) for posterior in context.anticipated]
        # The predicted power excludes the other robots' future measurements.
        same = context.anticipated == context.law.posteriors
        self._stations = self._expected if same else [near(each) for each in context.law.posteriors]

    def _grid(self, channel: LocalChannel, about_m: Floats) -> LocalGrid | None:
        """Return the map grid that measurements near `about_m` (a, 2) change; None if unused."""
        at = self._context
        if not _averages_map(at.problem):
            return None
        region = region_along(at.problem, at.near_region, about_m)
        every = max(1, round(len(region.weight) / CLIMBED_PLACES))
        return LocalGrid.of(channel, region.grid_m[::every], every * region.weight[::every])

    def __call__(self, paths_m: Floats) -> Floats:
        """Return objective values of paths (c, N, 2), minus penalties of violated constraints."""
        gate = None
        if self._measures:
            taken = self._context.near_measuring.takes(paths_m)
            gate = None if taken.all() else taken.astype(np.float64)
        return self._value(self._paths(paths_m, gate, order=0))

    def slopes(self, paths_m: Floats) -> tuple[Floats, Floats]:
        """Return smoothed values of paths, and their gradients w.r.t. positions ``(c, N, 2)``."""
        at = self._context
        gates = at.near_measuring.gates(paths_m) if self._measures else None
        gate = None if gates is None else gates.value
        paths = replace(self._paths(paths_m, gate, order=1), gates=gates)
        value = self._value(paths)
        slope = self._summed("slope", paths, paths_m.shape, "the gradient of each path")
        if self._missing_db_cost is not None and len(at.law.posteriors) == 1:
            # With several stations, the gradient of the chance constraint is omitted.
            slope -= self._missing_db_cost * missing_slope(at, paths.stations[0])
        return value, slope

    def _paths(self, paths_m: Floats, gate: Floats | None, order: int) -> Paths:
        """Return the paths with each station's predictions, and their gradients for `order` 1."""

        def along(stations: Sequence[_Station]) -> list[LocalPaths]:
            return [
                LocalPaths(own.channel, paths_m, gate, own.fine if order else own.coarse, order)
                for own in stations
            ]

        stations = measured = along(self._expected)
        if self._stations is not self._expected:
            stations = along(self._stations)
        return Paths(self._context, paths_m, stations, measured)

    def _summed(self, method: str, paths: Paths, shape: tuple[int, ...], words: str) -> Floats:
        """Return the weighted sum of what a method of the terms returns."""
        total = np.zeros(shape)
        for term in self._context.problem.terms:
            with calling(term, method, key="objective.terms"):
                found = getattr(term, method)(paths)
            total += term.weight * returned(term, method, found, shape, words=words, unbounded=True)
        return total

    def _value(self, paths: Paths) -> Floats:
        at, shape = self._context, (len(paths.paths_m),)
        value = self._summed("values", paths, shape, "one number for each path")
        if not at.problem.constraints.requires_connection:
            return value
        if self._missing_db_cost is None:
            self._missing_db_cost = MISSING_DB_SHARE * float(np.abs(value).max())
        return value - self._missing_db_cost * missing(at, paths.legs_m, paths.power)


def _averages_map(problem: Problem) -> bool:
    """Return whether the value of any term is an average over the map."""
    return any(term.averages_map for term in problem.terms)


def _thinned(grid: LocalGrid) -> LocalGrid:
    """Return every k-th position of a grid, about `RANKED_PLACES` in total."""
    every = max(1, round(len(grid.root_weight) / RANKED_PLACES))
    return LocalGrid(
        grid.positions_m[::every],
        math.sqrt(every) * grid.root_weight[::every],
        grid.solved[:, ::every],
        grid.trend[::every],
    )


def _anchors(paths_m: Floats, count: int) -> Floats:
    """Return up to `count` evenly selected positions (a, 2) of the paths."""
    places = paths_m.reshape(-1, 2)
    return places[np.linspace(0, len(places) - 1, min(count, len(places))).astype(np.intp)]


APART_STEPS = 0.5
"""Distance, in longest steps, within which corresponding positions of two paths count as equal."""
Drive = Callable[[Floats, Floats], Floats]
"""Function that maps turns and relative speeds (N, c) to paths (c, N, 2)."""
FIRST_STEP, LONGEST_STEP = 0.3, 0.8
"""Largest change of a heading (rad) or relative speed, in the first and in later ascent steps."""
SHORTER = 0.35  # Factor on the step length after an ascent step without gain
CURVED_SHARE = 1e-8
"""Minimum cosine between a step and the change of the gradient for a Hessian update."""
Slope = Callable[[Floats], tuple[Floats, Floats]]
"""Function that maps paths (c, N, 2) to their values (c,) and gradients (c, N, 2)."""


def distinct(paths_m: Floats, values: Floats, apart_m: float, count: int) -> Indices:
    """Return indices of up to `count` paths, best first, more than `apart_m` from each other."""
    kept: list[int] = []
    left = np.argsort(-values, kind="stable")
    while len(left) and len(kept) < count:
        best = int(left[0])
        kept.append(best)
        gap = np.abs(paths_m[left] - paths_m[best]).max(axis=(1, 2))
        left = left[gap > apart_m]
    return np.asarray(kept, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class _Climbers:
    """State of c paths in gradient ascent; a row of x has N headings, then N speeds."""

    paths_m: Floats
    x: Floats
    value: Floats
    slope: Floats
    inverse_hessian: Floats
    untouched: Mask
    share: Floats

    def take(self, rows: Indices) -> _Climbers:
        return _Climbers(*(getattr(self, each.name)[rows] for each in fields(self)))


def climb_paths(
    start_m: Floats,  # (2,) common start position
    paths_m: Floats,
    longest_m: float,
    drive: Drive,
    slope: Slope,
    rounds: tuple[int, ...],
    followed: tuple[int, ...],
    apart_m: float,
    budget: Budget = UNLIMITED,
) -> tuple[Floats, Floats]:
    """Return paths and values after gradient ascent from `paths_m` (c, N, 2), best first."""
    x = headings_and_speeds(start_m, paths_m, longest_m)
    value, by_place = slope(paths_m)
    at = _Climbers(
        paths_m,
        x,
        value,
        _by_command(by_place, x, longest_m),
        np.tile(np.eye(x.shape[1]), (len(x), 1, 1)),
        np.ones(len(x), dtype=np.bool_),
        np.ones(len(x)),
    )
    for count, kept in zip(rounds, followed, strict=True):
        for _ in range(count):
            if budget.searched:
                break
            at = _stepped(at, start_m, longest_m, drive, slope)
        at = at.take(distinct(at.paths_m, at.value, apart_m, kept))
    return at.paths_m, at.value


def _stepped(
    at: _Climbers, start_m: Floats, longest_m: float, drive: Drive, slope: Slope
) -> _Climbers:
    """Return the state after one ascent step per path, accepted if it increases the value."""
    half = at.x.shape[1] // 2
    probed = at.x + _direction(at)
    speed = np.clip(probed[:, half:], 0.0, 1.0)
    turn = np.diff(probed[:, :half], axis=1, prepend=0.0)
    paths = drive(turn.T.copy(), speed.T.copy())
    value, by_place = slope(paths)
    x = headings_and_speeds(start_m, paths, longest_m)
    # Headings of the same direction may differ by full turns.
    x[:, :half] += 2.0 * math.pi * np.round((probed[:, :1] - x[:, :1]) / (2.0 * math.pi))
    new = replace(at, paths_m=paths, x=x, value=value, slope=_by_command(by_place, x, longest_m))
    gained = value > at.value
    moved = _updated(at, new, gained)
    share = np.where(gained, 1.0, SHORTER * at.share)
    rows = np.flatnonzero(~gained)
    for kept, old in (
        (moved.paths_m, at.paths_m),
        (moved.x, at.x),
        (moved.value, at.value),
        (moved.slope, at.slope),
    ):
        kept[rows] = old[rows]
    return replace(moved, share=share)


def _direction(at: _Climbers) -> Floats:
    """Return ascent directions that keep speeds within their bounds."""
    half = at.x.shape[1] // 2
    speed, slope = at.x[:, half:], at.slope.copy()
    held = np.zeros(slope.shape, dtype=np.bool_)
    held[:, half:] = ((speed >= 1.0 - 1e-9) & (slope[:, half:] > 0.0)) | (
        (speed <= 1e-9) & (slope[:, half:] < 0.0)
    )
    slope[held] = 0.0
    step = (at.inverse_hessian @ slope[:, :, None])[:, :, 0]
    step[held] = 0.0
    downhill = (step * slope).sum(axis=1) <= 0.0
    step[downhill] = slope[downhill]
    size = np.maximum(np.abs(step).max(axis=1), np.finfo(float).tiny)
    # Without a curvature estimate, the gradient does not determine a step length.
    length = np.where(at.untouched, FIRST_STEP, np.minimum(size, LONGEST_STEP))
    return step * (at.share * length / size)[:, None]


def _updated(at: _Climbers, new: _Climbers, gained: Mask) -> _Climbers:
    """Return the state with BFGS updates of the inverse Hessians of improved paths."""
    step, change = new.x - at.x, at.slope - new.slope
    along = (step * change).sum(axis=1)
    size = np.sqrt((step**2).sum(axis=1) * (change**2).sum(axis=1))
    rows = np.flatnonzero(gained & (along > CURVED_SHARE * size))
    hessian, untouched = at.inverse_hessian.copy(), at.untouched.copy()
    if not len(rows):
        return new
    step, change, along = step[rows], change[rows], along[rows]
    first = np.where(untouched[rows], along / (change**2).sum(axis=1), 1.0)
    before = first[:, None, None] * hessian[rows]
    pulled = (before @ change[:, :, None])[:, :, 0] / along[:, None]
    crossed = step[:, :, None] * pulled[:, None]
    stretch = (1.0 + (change * pulled).sum(axis=1)) / along
    hessian[rows] = before - crossed - crossed.transpose(0, 2, 1)
    hessian[rows] += stretch[:, None, None] * step[:, :, None] * step[:, None]
    untouched[rows] = False
    return replace(new, inverse_hessian=hessian, untouched=untouched)


def headings_and_speeds(start_m: Floats, paths_m: Floats, longest_m: float) -> Floats:
    """Return the headings and relative speeds (c, 2 N) of paths; headings are continuous."""
    begin = np.broadcast_to(start_m, (len(paths_m), 1, 2))
    legs = np.diff(np.concatenate([begin, paths_m], axis=1), axis=1)
    length = np.hypot(legs[:, :, 0], legs[:, :, 1])
    heading = np.arctan2(legs[:, :, 1], legs[:, :, 0])
    # A step of length zero keeps the last heading.
    moved = (length > 0.0) * np.arange(int(paths_m.shape[1]))
    heading = np.take_along_axis(heading, np.maximum.accumulate(moved, axis=1), axis=1)
    turn = np.diff(heading, axis=1, prepend=0.0)
    turn = (turn + math.pi) % (2.0 * math.pi) - math.pi
    return np.concatenate([np.cumsum(turn, axis=1), np.minimum(length / longest_m, 1.0)], axis=1)


def _by_command(by_place: Floats, x: Floats, longest_m: float) -> Floats:
    """Return gradients (c, 2 N) w.r.t. headings and speeds, from gradients w.r.t. positions."""
    half = x.shape[1] // 2
    heading, speed = x[:, :half], x[:, half:]
    after = longest_m * np.cumsum(by_place[:, ::-1], axis=1)[:, ::-1]
    cos, sin = np.cos(heading), np.sin(heading)
    ahead = cos * after[..., 0] + sin * after[..., 1]
    aside = cos * after[..., 1] - sin * after[..., 0]
    return np.concatenate([speed * aside, ahead], axis=1)
