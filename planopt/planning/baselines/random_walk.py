"""Baselines of [GM11]: random walks of three kinds.

Steps that are not free are drawn again.
"""

from __future__ import annotations

import math
from time import perf_counter
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.planning.baselines.baseline import free_ends, held, released
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan
from planopt.planning.scene import Ground
from planopt.planning.search.moving_moves import steps_apart
from planopt.planning.tolerances import STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.problems.problem import Problem

DRAWS = 64
"""Steps drawn for one; the robot stands still where none is free."""

TURN_STD_RAD = 0.4
"""Standard deviation of the turn from one step of a persistent walk to the next."""

Walk = Literal["full", "disk", "persistent"]
"""Full steps in uniform directions, uniform over the disc of one step, or full steps that turn
little."""


class RandomPlanner:
    """Walks one robot of a problem at random."""

    def __init__(
        self,
        problem: Problem,
        ground: Ground,
        generator: np.random.Generator,
        walk: Walk = "full",
    ) -> None:
        self._problem, self._ground = problem, ground
        self._generator, self._walk = generator, walk

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is."""
        begun = perf_counter()
        path: list[NDArray[np.float64]] = []
        heading = None if warm is None else _heading(warm.positions_m[1] - warm.positions_m[0])
        here = situation.position_m
        for _ in range(self._problem.planner.horizon):
            offsets = self._offsets(heading)
            ends = here + (self._problem.step_length_m - STEP_PAD_M) * offsets
            free = free_ends(self._problem, self._ground, here, ends)
            begins = np.broadcast_to(here, ends.shape)
            free &= steps_apart(situation.moving, len(path), begins, ends)
            if not free.any():
                break
            first = int(free.argmax())
            heading, here = _heading(offsets[first]), ends[first]
            path.append(here)
        return released(judge, held(situation, path), begun)

    def _offsets(self, heading: float | None) -> NDArray[np.float64]:
        """Draw steps (`DRAWS`, 2) in units of the longest, after one in a direction or none."""
        drawn = self._generator.uniform(-math.pi, math.pi, DRAWS)
        lengths = np.ones(DRAWS)
        if self._walk == "disk":
            lengths = np.sqrt(self._generator.uniform(0.0, 1.0, DRAWS))
        elif self._walk == "persistent" and heading is not None:
            # The others are for where all of these are blocked.
            turns = self._generator.normal(0.0, TURN_STD_RAD, DRAWS // 2)
            drawn[: DRAWS // 2] = heading + turns
        return lengths[:, None] * np.column_stack([np.cos(drawn), np.sin(drawn)])


def _heading(step_m: NDArray[np.float64]) -> float | None:
    """Direction of a step (2,); None of one that stands still."""
    if np.linalg.norm(step_m) <= STANDSTILL_M:
        return None
    return math.atan2(float(step_m[1]), float(step_m[0]))
