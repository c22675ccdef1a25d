"""The log of a target over a run, row by row."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.log import TargetLog
from planopt.planning.loop.target_watch import TargetWatch, observed
from planopt.targets.information_filter import predict
from planopt.targets.sensor import noise_covariance_m2


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
        station_determinant_m4=np.array(
            [np.linalg.det(watch.station.covariance[:2, :2]) for watch in known]
        ),
        nees=np.array(
            [
                _squared(watch.station_mean_m - true_m, watch.station.covariance[:2, :2])
                for watch, true_m in zip(known, known[0].true_m, strict=False)
            ]
        ),
        nis=np.array([_innovations(*pair) for pair in pairwise(known)]).reshape(delivered.shape),
        delivered=delivered,
    )


def _innovations(before: TargetWatch, after: TargetWatch) -> list[float]:
    """Return nu' S^-1 nu of each robot's filter for the measurements of one step."""
    sent, found = after.sent[-1], list[float]()
    for state, measured, place, seen in zip(
        before.robots, sent.measured_m, sent.positions_m, sent.seen, strict=True
    ):
        ahead = predict(before.model, state)
        mean = ahead.mean[:2]
        noise = noise_covariance_m2(before.sensor, place[None], mean)[0]
        expected = ahead.covariance[:2, :2] + noise
        found.append(_squared(measured - mean, expected) if seen else float("nan"))
    return found


def _squared(error: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Return e' P^-1 e."""
    return float(error @ np.linalg.solve(covariance, error))


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
