"""Straight ways in all directions, as starts for objectives that a lattice search cannot add up."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.planning.situation import Situation
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.world.clearance import ObstacleIndex, inside_bounds, swept_clearance_m

HEADINGS = 24
"""Directions of the fan."""

TURNS_RAD = (0.0, 0.5, -0.5)
"""How far a way of the fan turns in all, in units of pi: straight, to the left, to the right."""


def straight_starts(
    situation: Situation, index: ObstacleIndex, horizon: int
) -> list[NDArray[np.float64]]:
    """Ways (N, 2) at full speed, each standing still from where it would leave the free space.

    Parameters
    ----------
    situation
        Where the robot is, and its limits.
    index
        The obstacles.
    horizon
        N.
    """
    problem = situation.problem
    step = problem.step_length_m - STEP_PAD_M
    steps = np.arange(horizon)
    ways: list[NDArray[np.float64]] = []
    for heading in 2.0 * math.pi * np.arange(HEADINGS) / HEADINGS:
        for turn in TURNS_RAD if horizon > 1 else TURNS_RAD[:1]:
            angle = heading + turn * math.pi * steps / max(horizon - 1, 1)
            way = np.vstack(
                [
                    situation.position_m,
                    situation.position_m
                    + step * np.cumsum(np.column_stack([np.cos(angle), np.sin(angle)]), axis=0),
                ]
            )
            free = inside_bounds(problem.workspace, way[1:])
            clear = swept_clearance_m(index, way)
            free &= clear >= problem.constraints.clearance_m + CLEARANCE_PAD_M
            last = int(np.argmin(free)) if not free.all() else horizon
            if last:
                way[last + 1 :] = way[last]
                ways.append(way[1:])
    return ways
