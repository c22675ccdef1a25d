"""Ways by the station: there path loss changes most, within a step, where no fan happens to lead.

A measurement beside the station tells far more of path loss than any other, and path loss is least
known there, so that what is learnt or mapped has a narrow maximum at it. A way that comes within a
step of it need not end there when it is polished.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

ONWARD = 8
"""Directions in which ways go on from there."""

DETOURS = 2
"""Ways there take so many steps more than need be, at most: arcs, to either side."""


def commands_via(
    start_m: NDArray[np.float64], place_m: NDArray[np.float64], horizon: int, longest_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Turns and speeds ``(N, c)`` of ways to a place, straight or in an arc, then on or waiting.

    None where it is out of reach.

    Parameters
    ----------
    start_m, place_m
        ``(2,)``.
    horizon, longest_m
        N, and the longest step.
    """
    offset = place_m - start_m
    distance = float(np.hypot(*offset))
    fewest = math.ceil(distance / longest_m)
    if not 0 < fewest <= horizon:
        return None
    ways = [
        _onward(math.atan2(offset[1], offset[0]), side * _arc_turn(distance / longest_m, steps),
                distance / (steps * longest_m) if steps == fewest else 1.0, steps, horizon)
        for steps in range(fewest, min(fewest + DETOURS, horizon) + 1)
        for side in ((1.0, -1.0) if steps > fewest else (0.0,))
    ]
    turns, speeds = zip(*ways, strict=True)
    return np.concatenate(turns, axis=1), np.concatenate(speeds, axis=1)


def _arc_turn(chord: float, steps: int) -> float:
    """The turn before each step but the first of an arc of unit steps over a chord."""
    if chord >= steps - 1e-9:
        return 0.0
    return float(brentq(lambda a: math.sin(0.5 * steps * a) / math.sin(0.5 * a) - chord,
                        1e-9, 2.0 * math.pi / steps))


def _onward(heading, each, share, steps, horizon):
    on = ONWARD + 1 if steps < horizon else 1
    turn, speed = np.zeros((horizon, on)), np.ones((horizon, on))
    turn[0] = heading - 0.5 * each * (steps - 1)
    turn[1:steps] = each
    speed[:steps] = share
    if steps < horizon:
        turn[steps, :ONWARD] += 2.0 * math.pi * np.arange(ONWARD) / ONWARD
        speed[steps:, ONWARD] = 0.0
    return turn, speed
