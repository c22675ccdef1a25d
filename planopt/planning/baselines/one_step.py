"""The one-step planner of [GM11]: the best of a dense set of places within one step.

Equations (2), the inner layer of (3), and (4) are maximised over places within one step, each of
them free and, where measuring is what counts, not measured yet ("q not in Q" in [GM11]). A plan of
more steps repeats this greedily on what would be known after the earlier ones: each step gains what
the whole path so far is worth more than before. From a place around which all is measured the robot
takes the shortest way out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.planning.baselines.baseline import free_ends, held, released
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan
from planopt.planning.scene import Ground
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.search.moving_moves import steps_apart
from planopt.planning.search.to_unmeasured import way_to_unmeasured
from planopt.planning.tolerances import STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.planning.values.exploration import learns
from planopt.problems.problem import Problem

RINGS, HEADINGS = 10, 48
"""Places within a step: on so many circles in so many directions, and the robot's own."""


Score = Callable[[StepContext, NDArray[np.float64]], NDArray[np.float64]]
"""From paths (c, N, 2) to what each is worth (c,)."""


def as_ranked(situation: StepContext, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what paths (c, N, 2) are worth by the terms of the problem; ``(c,)``."""
    return LocalRanking(situation, ways_m)(ways_m)


def end_deviation(situation: StepContext, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviation of predicted power where paths (c, N, 2) end, dB; ``(c,)``."""
    return situation.power(ways_m[:, -1]).deviation_db


class OneStepPlanner:
    """Plans greedily for one robot of a problem whose objective is a sum of terms."""

    def __init__(self, problem: Problem, ground: Ground, score: Score = as_ranked) -> None:
        self._problem, self._ground, self._score = problem, ground, score
        self._measures = learns(problem)
        # An expression is for a whole path: it is valued as if the robot then stood.
        self._whole = any(
            term.structure == "full" and not (term.is_measured or term.steers or term.tries_places)
            for term in problem.terms
        )
        radius = (problem.step_length_m - STEP_PAD_M) * np.arange(1, RINGS + 1) / RINGS
        angle = 2.0 * math.pi * np.arange(HEADINGS) / HEADINGS
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        rings = (radius[:, None, None] * circle).reshape(-1, 2)
        self._offsets_m = np.vstack([np.zeros((1, 2)), rings])

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is; arguments as of the horizon planner, `warm` is not used."""
        begun = perf_counter()
        path: list[NDArray[np.float64]] = []
        for _ in range(self._problem.planner.horizon):
            step = self._best_step(situation, path)
            if step is None:
                break
            path.append(step)
        if not path and self._measures:
            out = way_to_unmeasured(situation, self._ground)
            path = [] if out is None else list(out)
        return released(judge, held(situation, path), begun)

    def _best_step(
        self, situation: StepContext, path: list[NDArray[np.float64]]
    ) -> NDArray[np.float64] | None:
        """The best place to go to after `path`; None if there is none."""
        here = path[-1] if path else situation.position_m
        ends = here + self._offsets_m
        allowed = free_ends(self._problem, self._ground, here, ends)
        begins = np.broadcast_to(here, ends.shape)
        before = np.broadcast_to(np.reshape(path, (-1, 2)), (len(ends), len(path), 2))
        allowed &= steps_apart(situation.moving, len(path), begins, ends)
        if self._measures:
            ahead = np.concatenate([before, ends[:, None]], axis=1)
            allowed &= situation.near_measuring.takes(ahead)[:, -1]
        ends = ends[allowed]
        if not len(ends):
            return None
        ways = np.concatenate([before[allowed], ends[:, None]], axis=1)
        if self._whole:
            rest = self._problem.planner.horizon - int(ways.shape[1])
            ways = np.concatenate([ways, np.repeat(ways[:, -1:], rest, axis=1)], axis=1)
        return ends[int(np.argmax(self._score(situation, ways)))]
