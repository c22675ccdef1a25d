"""Batched BFGS ascent: many paths climb at once, each with its own inverse Hessian.

Objectives that couple the positions of a path have several maxima, and the value of an initial
guess hardly predicts its value after refinement. The variables are headings and speeds, so that the
motion limits are bounds of single variables. At a blocked step the path turns aside, as in the fan
of guesses; the step is accepted if the value increases.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.candidates import UNLIMITED, Budget

APART_STEPS = 0.5
"""Two paths count as one if they differ by at most this many longest steps at every position."""

Drive = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""Function from turns and speeds (N, c) to paths (c, N, 2)."""

FIRST_STEP, LONGEST_STEP = 0.3, 0.8
"""Largest change of a heading (rad) or a relative speed in the first step, and in later steps."""

SHORTER = 0.35
"""Factor of the step length after a step without gain."""

CURVED_SHARE = 1e-8
"""Least cosine between a step and the change of the gradient that updates the Hessian."""

Slope = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Function from paths (c, N, 2) to their values (c,) and gradients (c, N, 2)."""


def distinct(
    paths_m: NDArray[np.float64], values: NDArray[np.float64], apart_m: float, count: int
) -> NDArray[np.intp]:
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
    """State of c climbing paths; a row of x has N headings, then N speeds."""

    paths_m: NDArray[np.float64]
    x: NDArray[np.float64]
    value: NDArray[np.float64]
    slope: NDArray[np.float64]
    inverse_hessian: NDArray[np.float64]
    untouched: NDArray[np.bool_]
    share: NDArray[np.float64]

    def take(self, rows: NDArray[np.intp]) -> _Climbers:
        return _Climbers(*(getattr(self, each.name)[rows] for each in fields(self)))


def climb_paths(
    start_m: NDArray[np.float64],  # (2,) common start position
    paths_m: NDArray[np.float64],
    longest_m: float,
    drive: Drive,
    slope: Slope,
    rounds: tuple[int, ...],
    followed: tuple[int, ...],
    apart_m: float,
    budget: Budget = UNLIMITED,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Climb from `paths_m` (c, N, 2); return paths and values, best first, none below its guess."""
    x = _headings_and_speeds(start_m, paths_m, longest_m)
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
    at: _Climbers, start_m: NDArray[np.float64], longest_m: float, drive: Drive, slope: Slope
) -> _Climbers:
    """Return the state after one step of every path, accepted where the value increases."""
    half = at.x.shape[1] // 2
    probed = at.x + _direction(at)
    speed = np.clip(probed[:, half:], 0.0, 1.0)
    turn = np.diff(probed[:, :half], axis=1, prepend=0.0)
    paths = drive(turn.T.copy(), speed.T.copy())
    value, by_place = slope(paths)
    x = _headings_and_speeds(start_m, paths, longest_m)
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


def _direction(at: _Climbers) -> NDArray[np.float64]:
    """Return ascent steps; a speed at its bound does not move beyond it."""
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


def _updated(at: _Climbers, new: _Climbers, gained: NDArray[np.bool_]) -> _Climbers:
    """Return the BFGS update of the inverse Hessians (of minus the value) of paths that gained."""
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


def _headings_and_speeds(
    start_m: NDArray[np.float64], paths_m: NDArray[np.float64], longest_m: float
) -> NDArray[np.float64]:
    """Return headings, continuous along a path, and relative speeds; (c, 2 N)."""
    begin = np.broadcast_to(start_m, (len(paths_m), 1, 2))
    legs = np.diff(np.concatenate([begin, paths_m], axis=1), axis=1)
    length = np.hypot(legs[:, :, 0], legs[:, :, 1])
    heading = np.arctan2(legs[:, :, 1], legs[:, :, 0])
    # A step of zero length keeps the last heading.
    moved = (length > 0.0) * np.arange(int(paths_m.shape[1]))
    heading = np.take_along_axis(heading, np.maximum.accumulate(moved, axis=1), axis=1)
    turn = np.diff(heading, axis=1, prepend=0.0)
    turn = (turn + math.pi) % (2.0 * math.pi) - math.pi
    return np.concatenate([np.cumsum(turn, axis=1), np.minimum(length / longest_m, 1.0)], axis=1)


def _by_command(
    by_place: NDArray[np.float64], x: NDArray[np.float64], longest_m: float
) -> NDArray[np.float64]:
    """Return gradients (c, 2 N) by headings and speeds; a step moves all later positions."""
    half = x.shape[1] // 2
    heading, speed = x[:, :half], x[:, half:]
    after = longest_m * np.cumsum(by_place[:, ::-1], axis=1)[:, ::-1]
    cos, sin = np.cos(heading), np.sin(heading)
    ahead = cos * after[..., 0] + sin * after[..., 1]
    aside = cos * after[..., 1] - sin * after[..., 0]
    return np.concatenate([speed * aside, ahead], axis=1)
