"""Steering paths of robots, and the remaining distance along them.

The distance is straight to the next visible turn, then along the path. Its gradient leads around
obstacles; that of the straight-line distance leads a robot into their corners.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, segments_clear

if TYPE_CHECKING:
    # Type checkers do not accept a cached property for a property of a protocol.
    cached_property = property
else:
    from functools import cached_property


@dataclass(frozen=True, eq=False)
class SteeringWay:
    """Path from a robot's position to its steering target."""

    # (m, 2), m at least 2: the robot's position, the turns, and the end
    turns_m: NDArray[np.float64]
    index: ObstacleIndex  # The obstacles
    clearance_m: float  # Minimum distance to obstacles
    # (ny, nx) length of the shortest path to the end from each node of the lattice, if known
    lattice_m: NDArray[np.float64] | None = None
    # Whether a position may advance at most to the end of its nearest leg: the path also avoids
    # coverage holes, across which later turns may be visible
    in_order: bool = False

    @property
    def end_m(self) -> NDArray[np.float64]:
        """Return the position (2,) that the robot is steered to."""
        return self.turns_m[-1]

    @cached_property
    def rest_m(self) -> NDArray[np.float64]:
        """Return the remaining path length (m,) from each turn."""
        legs = np.linalg.norm(np.diff(self.turns_m, axis=0), axis=1)
        return np.concatenate([np.cumsum(legs[::-1])[::-1], [0.0]])

    def next_turns(self, places_m: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the index of the turn that each position (n, 2) heads for directly.

        It is the last of the first consecutive visible turns; positions that see no turn return to
        the start of the path.
        """
        found = np.zeros(len(places_m), dtype=np.intp)
        left = np.arange(len(places_m))
        last = self._ends_of_legs(places_m) if self.in_order else None
        for turn in range(1, len(self.turns_m)):
            if last is not None:
                left = left[last[left] >= turn]
            there = np.broadcast_to(self.turns_m[turn], (len(left), 2))
            seen = segments_clear(
                self.index, places_m[left], there, self.clearance_m, CLEARANCE_TOLERANCE_M
            )
            found[left[seen]] = turn
            left = left[seen | (found[left] == 0)]
            if not len(left):
                break
        return found

    def _ends_of_legs(self, places_m: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the index of the turn at the end of the leg nearest to each position."""
        starts, legs = self.turns_m[:-1], np.diff(self.turns_m, axis=0)
        offset = places_m[:, None] - starts
        length2 = np.maximum((legs**2).sum(axis=1), np.finfo(float).tiny)
        along = np.clip((offset * legs).sum(axis=2) / length2, 0.0, 1.0)
        away = np.linalg.norm(offset - along[:, :, None] * legs, axis=2)
        return len(legs) - away[:, ::-1].argmin(axis=1)

    def distance_m(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the remaining distance from each position (n, 2) to the end; (n,)."""
        turns = self.next_turns(places_m)
        return np.linalg.norm(places_m - self.turns_m[turns], axis=1) + self.rest_m[turns]

    def path_m(self, steps: int, longest_m: float) -> NDArray[np.float64]:
        """Return positions along the path, with a step end at every turn; ``(steps, 2)``."""
        found: list[NDArray[np.float64]] = []
        here = self.turns_m[0]
        for turn in self.turns_m[1:]:
            count = max(math.ceil(float(np.linalg.norm(turn - here)) / longest_m), 1)
            found += [here + (turn - here) * k / count for k in range(1, count + 1)]
            here = turn
            if len(found) >= steps:
                break
        found += [here] * (steps - len(found))
        return np.array(found[:steps])

    def gained_m(self, paths_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the reduction of the distance to the end, summed over positions (..., N, 2)."""
        distance = self.distance_m(paths_m.reshape(-1, 2)).reshape(paths_m.shape[:-1])
        return (self.rest_m[0] - distance).sum(axis=-1)


def steering_way(
    problem: Problem,
    index: ObstacleIndex,
    turns_m: NDArray[np.float64],
    lattice_m: NDArray[np.float64] | None = None,
) -> SteeringWay:
    """Return the path through `turns_m` (m, 2) along which a problem's terms steer."""
    in_order = any(term.steers == "goal" for term in problem.terms)
    return SteeringWay(turns_m, index, problem.constraints.clearance_m, lattice_m, in_order)
