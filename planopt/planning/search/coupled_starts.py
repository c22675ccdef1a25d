"""Starts where the places of a way belong together: a fan of ways, the best of which climb.

Terms whose slopes are not known batched are bent at random instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.budget import UNLIMITED, Budget
from planopt.planning.ground import Ground
from planopt.planning.search.local_ranking import LocalRanking, can_climb
from planopt.planning.search.rough_clearance import rough_clearance
from planopt.planning.search.straight_starts import driven_ways, straight_starts
from planopt.planning.search.via_station import commands_via
from planopt.planning.search.way_climb import climb_ways
from planopt.planning.search.way_search import APART_STEPS, distinct, search_ways
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem
from planopt.world.moving_discs import ways_gap_m

SEED = 0
"""Every search begins anew from it: the same situation has the same starts."""

VALUED = 4
"""Ways that are handed on of those bent, to be valued by all measurements."""

CLIMBING = 12
"""Ways that climb at first."""

ROUNDS, FOLLOWED = (3, 3, 4), (6, 3, 3)
"""After so many steps of the climb each, so many ways are followed on."""


class CoupledStarts:
    """Finds ways for one robot of a problem; keeps its raster of distances.

    Parameters
    ----------
    problem
        With one robot and a sum of terms.
    ground
        Its geometry.
    """

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        self._index = ground.index
        self._rough = rough_clearance(problem, ground.index)

    def find_ways(
        self,
        situation: Situation,
        known_m: list[NDArray[np.float64]],
        budget: Budget = UNLIMITED,
    ) -> list[NDArray[np.float64]]:
        """The best ways (N, 2), told apart, best first by what is measured near them.

        Parameters
        ----------
        situation
            What is known.
        known_m
            Ways (N, 2) found otherwise, to be improved with the others.
        budget
            Until when they are improved.
        """
        fan = straight_starts(situation, self._index, self._rough, self._problem.planner.horizon)
        longest = self._problem.step_length_m - STEP_PAD_M

        def drive(turn: NDArray[np.float64], speed: NDArray[np.float64]) -> NDArray[np.float64]:
            return driven_ways(situation, self._index, self._rough, turn, speed)

        ways = np.concatenate([np.asarray(known_m).reshape(-1, *fan.shape[1:]), fan])
        if can_climb(self._problem) and not situation.posterior.theta_known:
            station = np.asarray(situation.posterior.parameters.station.position_m)
            via = commands_via(situation.position_m, station, int(fan.shape[1]), longest)
            ways = ways if via is None else np.concatenate([ways, drive(*via)])
        ranking = LocalRanking(situation, ways)

        def value(ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.where(self._is_apart(situation, ways_m), ranking(ways_m), -np.inf)

        if not can_climb(self._problem):
            generator = np.random.default_rng(SEED)
            found, _ = search_ways(
                situation.position_m, ways, longest, drive, value, generator, budget
            )
            return list(found[:VALUED])
        apart = APART_STEPS * longest
        best = ways[distinct(ways, value(ways), apart, CLIMBING)]

        def slopes(ways_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            worth, slope = ranking.slopes(ways_m)
            return np.where(self._is_apart(situation, ways_m), worth, -np.inf), slope

        found, _ = climb_ways(
            situation.position_m, best, longest, drive, slopes, ROUNDS, FOLLOWED, apart, budget
        )
        return list(found)

    def _is_apart(self, situation: Situation, ways_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether ways (c, N, 2) keep from all that moves; ``(c,)``."""
        begin = np.broadcast_to(situation.position_m, (len(ways_m), 1, 2))
        whole = np.concatenate([begin, ways_m], axis=1)
        return ways_gap_m(situation.circumstances.moving, whole) >= -CLEARANCE_TOLERANCE_M
