"""Baseline of [GM11]: full steps in random directions, drawn anew or kept until blocked.

Directions are drawn uniformly, and those that are not free drawn again.
"""

from __future__ import annotations

import math
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.planning.baselines.baseline import free_ends, held, released
from planopt.planning.ground import Ground
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan
from planopt.planning.search.moving_moves import steps_apart
from planopt.planning.tolerances import STANDSTILL_M, STEP_PAD_M
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem

DRAWS = 64
"""Directions drawn for a step; the robot stands still where none is free."""


class RandomPlanner:
    """Walks one robot of a problem at random.

    Parameters
    ----------
    problem
        With one robot.
    ground
        Its geometry.
    generator
        Draws the directions.
    persistent
        Keep the direction while it is free.
    """

    def __init__(
        self,
        problem: Problem,
        ground: Ground,
        generator: np.random.Generator,
        persistent: bool = False,
    ) -> None:
        self._problem, self._ground = problem, ground
        self._generator, self._persistent = generator, persistent

    def plan(self, situation: Situation, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is.

        Parameters
        ----------
        situation, judge
            As of the horizon planner.
        warm
            The plan that led here, whose direction is kept where directions persist.
        """
        begun = perf_counter()
        path: list[NDArray[np.float64]] = []
        heading = None if warm is None else _heading(warm.positions_m[1] - warm.positions_m[0])
        here = situation.position_m
        for _ in range(self._problem.planner.horizon):
            drawn = self._generator.uniform(-math.pi, math.pi, DRAWS)
            if self._persistent and heading is not None:
                drawn[0] = heading
            offsets = np.column_stack([np.cos(drawn), np.sin(drawn)])
            ends = here + (self._problem.step_length_m - STEP_PAD_M) * offsets
            free = free_ends(self._problem, self._ground, here, ends)
            begins = np.broadcast_to(here, ends.shape)
            free &= steps_apart(situation.circumstances.moving, len(path), begins, ends)
            if not free.any():
                break
            first = int(free.argmax())
            heading, here = float(drawn[first]), ends[first]
            path.append(here)
        return released(judge, held(situation, path), begun)


def _heading(step_m: NDArray[np.float64]) -> float | None:
    """Direction of a step (2,); None of one that stands still."""
    if np.linalg.norm(step_m) <= STANDSTILL_M:
        return None
    return math.atan2(float(step_m[1]), float(step_m[0]))
