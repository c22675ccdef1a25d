"""Improve many ways at once, where no dynamic programming applies: bend the best, then climb.

Objectives that couple the places of a way have several maxima that no stand-in tells apart. So the
best ways, told apart by where they lead, are bent at random in a few rounds (:func:`search_ways`),
valued by the objective itself, batched. Directions are drawn anew in each round, narrower each
time, from one generator, so that the same seed finds the same ways.

The value of a path before a refinement says little of its value after. So the best climb together
(:func:`climb_ways`), batched, each with its own inverse Hessian (BFGS), and only those that lead
are followed on. In headings and speeds the limits of motion are bounds of single variables; at a
blocked step the way turns aside as when it was first driven, and the step counts if it gains.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.candidates import UNLIMITED, Budget

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
    start_m: NDArray[np.float64],  # (2,) where all begin
    ways_m: NDArray[np.float64],
    longest_m: float,
    drive: Drive,
    value: Value,
    generator: np.random.Generator,
    budget: Budget = UNLIMITED,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Improve on `ways_m` (c, N, 2); the best ways, told apart, and their worths, best first."""
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


FIRST_STEP, LONGEST_STEP = 0.3, 0.8
"""Largest change of a heading (rad) or of a speed (as a share) in a first step, and in any."""

SHORTER = 0.35
"""A step that does not gain is tried again at this share of its length."""

CURVED_SHARE = 1e-8
"""Least cosine between a step and the change of slope along it that curvature is learnt from."""

Slope = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""From ways (c, N, 2) to their worths (c,) and the derivatives of these (c, N, 2)."""


@dataclass(frozen=True, eq=False)
class _Climbers:
    """c ways on their way up; x are N headings, then N speeds."""

    ways_m: NDArray[np.float64]
    x: NDArray[np.float64]
    worth: NDArray[np.float64]
    slope: NDArray[np.float64]
    inverse_hessian: NDArray[np.float64]
    unlearnt: NDArray[np.bool_]
    share: NDArray[np.float64]

    def take(self, rows: NDArray[np.intp]) -> _Climbers:
        return _Climbers(*(getattr(self, each.name)[rows] for each in fields(self)))


def climb_ways(
    start_m: NDArray[np.float64],  # (2,) where all begin
    ways_m: NDArray[np.float64],
    longest_m: float,
    drive: Drive,
    slope: Slope,
    rounds: tuple[int, ...],
    followed: tuple[int, ...],
    apart_m: float,
    budget: Budget = UNLIMITED,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Climb from `ways_m` (c, N, 2); the ways at the end and their worths, best first.

    No way ends below where it began.
    """
    at = _begun(start_m, ways_m, longest_m, slope)
    for count, kept in zip(rounds, followed, strict=True):
        for _ in range(count):
            if budget.searched:
                break
            at = _stepped(at, start_m, longest_m, drive, slope)
        at = at.take(distinct(at.ways_m, at.worth, apart_m, kept))
    return at.ways_m, at.worth


def _begun(
    start_m: NDArray[np.float64], ways_m: NDArray[np.float64], longest_m: float, slope: Slope
) -> _Climbers:
    x = _headings_and_speeds(start_m, ways_m, longest_m)
    worth, by_place = slope(ways_m)
    return _Climbers(
        ways_m,
        x,
        worth,
        _by_command(by_place, x, longest_m),
        np.tile(np.eye(x.shape[1]), (len(x), 1, 1)),
        np.ones(len(x), dtype=np.bool_),
        np.ones(len(x)),
    )


def _stepped(
    at: _Climbers, start_m: NDArray[np.float64], longest_m: float, drive: Drive, slope: Slope
) -> _Climbers:
    """One step of every way, taken where it gains."""
    half = at.x.shape[1] // 2
    tried = at.x + _direction(at)
    speed = np.clip(tried[:, half:], 0.0, 1.0)
    turn = np.diff(tried[:, :half], axis=1, prepend=0.0)
    ways = drive(turn.T.copy(), speed.T.copy())
    worth, by_place = slope(ways)
    x = _headings_and_speeds(start_m, ways, longest_m)
    # The whole way may have been turned round.
    x[:, :half] += 2.0 * math.pi * np.round((tried[:, :1] - x[:, :1]) / (2.0 * math.pi))
    new = replace(at, ways_m=ways, x=x, worth=worth, slope=_by_command(by_place, x, longest_m))
    gained = worth > at.worth
    moved = _learnt(at, new, gained)
    share = np.where(gained, 1.0, SHORTER * at.share)
    rows = np.flatnonzero(~gained)
    for kept, old in (
        (moved.ways_m, at.ways_m),
        (moved.x, at.x),
        (moved.worth, at.worth),
        (moved.slope, at.slope),
    ):
        kept[rows] = old[rows]
    return replace(moved, share=share)


def _direction(at: _Climbers) -> NDArray[np.float64]:
    """Steps uphill; speeds that are at a bound and would leave it stay there."""
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
    # Without curvature yet, a step has no length of its own.
    length = np.where(at.unlearnt, FIRST_STEP, np.minimum(size, LONGEST_STEP))
    return step * (at.share * length / size)[:, None]


def _learnt(at: _Climbers, new: _Climbers, gained: NDArray[np.bool_]) -> _Climbers:
    """The BFGS update of the inverse Hessian (of minus the worth) of the ways that gained."""
    step, change = new.x - at.x, at.slope - new.slope
    along = (step * change).sum(axis=1)
    size = np.sqrt((step**2).sum(axis=1) * (change**2).sum(axis=1))
    rows = np.flatnonzero(gained & (along > CURVED_SHARE * size))
    hessian, unlearnt = at.inverse_hessian.copy(), at.unlearnt.copy()
    if not len(rows):
        return new
    step, change, along = step[rows], change[rows], along[rows]
    first = np.where(unlearnt[rows], along / (change**2).sum(axis=1), 1.0)
    before = first[:, None, None] * hessian[rows]
    pulled = (before @ change[:, :, None])[:, :, 0] / along[:, None]
    crossed = step[:, :, None] * pulled[:, None]
    stretch = (1.0 + (change * pulled).sum(axis=1)) / along
    hessian[rows] = before - crossed - crossed.transpose(0, 2, 1)
    hessian[rows] += stretch[:, None, None] * step[:, :, None] * step[:, None]
    unlearnt[rows] = False
    return replace(new, inverse_hessian=hessian, unlearnt=unlearnt)


def _headings_and_speeds(
    start_m: NDArray[np.float64], ways_m: NDArray[np.float64], longest_m: float
) -> NDArray[np.float64]:
    """``(c, 2 N)`` headings, without jumps along a way, and speeds as shares of the largest."""
    turn, speed = commands_of(start_m, ways_m, longest_m)
    return np.concatenate([np.cumsum(turn, axis=0), speed]).T.copy()


def _by_command(
    by_place: NDArray[np.float64], x: NDArray[np.float64], longest_m: float
) -> NDArray[np.float64]:
    """Derivatives (c, 2 N) by headings and speeds: a step moves all places after it."""
    half = x.shape[1] // 2
    heading, speed = x[:, :half], x[:, half:]
    after = longest_m * np.cumsum(by_place[:, ::-1], axis=1)[:, ::-1]
    cos, sin = np.cos(heading), np.sin(heading)
    ahead = cos * after[..., 0] + sin * after[..., 1]
    aside = cos * after[..., 1] - sin * after[..., 0]
    return np.concatenate([speed * aside, ahead], axis=1)
