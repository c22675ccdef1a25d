"""Ways by the station: there path loss changes most, within a step, where no fan happens to lead.

A measurement beside the station tells far more of path loss than any other, and path loss is least
known there, so that what is learnt or mapped has a narrow maximum at it. A way that comes within a
step of it need not end there when it is polished.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

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

    Parameters
    ----------
    start_m, place_m
        ``(2,)``.
    horizon, longest_m
        N, and the longest step.
    """
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
