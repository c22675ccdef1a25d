"""The log of a target over a run, row by row."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.log import TargetLog
from planopt.planning.loop.target_watch import TargetWatch, observed


def target_log(
    watches: Iterable[TargetWatch | None], delivered: NDArray[np.bool_]
) -> TargetLog | None:
    """The log of what was known after each step, the start first; None without target.

    Parameters
    ----------
    watches
        ``steps + 1`` of them, or None throughout.
    delivered
        ``(steps, robots)`` whose packets arrived.
    """
    known = [watch for watch in watches if watch is not None]
    if not known:
        return None
    return TargetLog(
        true_m=known[0].true_m[: len(known)],
        station_mean_m=np.array([watch.station_mean_m for watch in known]),
        station_variance_m2=np.array([watch.station_variance_m2 for watch in known]),
        delivered=delivered,
    )


def watched(
    first: TargetWatch | None,
    tracks_m: NDArray[np.float64],
    delivered: NDArray[np.bool_],
    generator: np.random.Generator,
) -> list[TargetWatch | None]:
    """What is known of the target after each step of robots that have been driven already.

    Parameters
    ----------
    first
        At the start; None without target.
    tracks_m
        ``(robots, steps + 1, 2)`` where they were.
    delivered
        ``(steps, robots)`` whose packets arrived.
    generator
        As it is after drawing `first`.
    """
    watches = [first]
    for step, arrived in enumerate(delivered, start=1):
        watch = watches[-1]
        here = tracks_m[:, step]
        watches.append(None if watch is None else observed(watch, step, here, arrived, generator))
    return watches
