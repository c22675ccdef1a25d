"""Climb from many ways at once: quasi-Newton steps in headings and speeds, the worse ways dropped.

What a way is worth before it is polished tells little of what it is worth after. So the best ways
climb together, batched, each with its own inverse Hessian (BFGS), and only those that lead are
followed on. In headings and speeds the limits of motion are bounds of single variables; where a
step is blocked the way turns aside as when it was first driven, and the step counts if it gains.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.budget import UNLIMITED, Budget
from planopt.planning.search.way_search import Drive, commands_of, distinct

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
    start_m: NDArray[np.float64],
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

    Parameters
    ----------
    start_m
        ``(2,)`` where all begin.
    ways_m
        Ways to begin with.
    longest_m
        Longest step.
    drive, slope
        See their types.
    rounds, followed
        After so many steps each, so many ways are followed on; ways that have come nearer than
        `apart_m` to a better one are not.
    budget
        Until when steps begin.
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
