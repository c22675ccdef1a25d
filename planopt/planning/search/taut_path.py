"""Lattice paths, pulled taut and sampled in time.

Separating lines belong to segments, so that a guess that passes a corner one step late stays late
in refinement. Sampling at cruising speed (:func:`retime`) lets it pass the corner in time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planopt.planning.scene import Ground, first_moves
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.problems.problem import Problem
from planopt.world.clearance import segments_clear
from planopt.world.lattice import REACH_TOLERANCE_M, CostToGo, lattice_paths, route_from

STRAIGHT_SHARE = 1e-9
"""Least difference of two legs' directions that counts as a turn."""


class PathsFrom:
    """Shortest paths from one position to all reachable nodes of a lattice."""

    def __init__(
        self,
        problem: Problem,
        ground: Ground,
        position_m: NDArray[np.float64],
        limit_m: float = math.inf,
    ) -> None:
        self._ground, self._position_m = ground, position_m
        self._wanted_m = problem.constraints.clearance_m + CLEARANCE_PAD_M
        nodes, lengths = first_moves(ground, problem, position_m)
        self.length_m = np.full(len(ground.road_map.nodes_m), np.inf)
        self._ways: CostToGo | None = None
        if len(nodes):
            nearest = int(np.argmin(lengths))
            self._ways = lattice_paths(ground.road_map, int(nodes[nearest]), limit_m=limit_m)
            self.length_m = self._ways.cost_m + float(lengths[nearest])

    def straight(self, places_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether the straight line to each position (n, 2) is collision-free."""
        starts = np.broadcast_to(self._position_m, places_m.shape)
        return segments_clear(self._ground.index, starts, places_m, self._wanted_m)

    def turns_m(self, node: int, end_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the turns (m, 2) of the path to a position (2,) next to `node`, ends included."""
        if self._ways is None:
            raise AssertionError("no node is reachable")
        nodes = route_from(self._ground.road_map, self._ways, node, math.inf)[::-1]
        corners = np.vstack([self._position_m, self._ground.road_map.nodes_m[nodes], end_m])
        return taut_turns(self._ground, self._wanted_m, corners)


def taut_turns(
    ground: Ground,
    clearance_m: float,
    corners_m: NDArray[np.float64],  # (n, 2)
    is_cheap: Callable[[int], NDArray[np.bool_]] | None = None,
) -> NDArray[np.float64]:
    """Return the turns (m, 2) of a taut path: each turn is the farthest one visible from the last.

    `is_cheap` maps a corner's index to a mask of the later corners with a cheap straight leg.
    """
    turns, last = [corners_m[0]], 0
    while last < len(corners_m) - 1:
        ahead = corners_m[last + 1 :]
        starts = np.broadcast_to(corners_m[last], ahead.shape)
        allowed = segments_clear(ground.index, starts, ahead, clearance_m)
        if is_cheap is not None:
            allowed &= is_cheap(last)
        seen = np.flatnonzero(allowed)
        # The next corner is one move away and needs no test of clearance or cost.
        last += 1 + (int(seen[-1]) if len(seen) else 0)
        turns.append(corners_m[last])
    return np.array(turns)


def stops_along(corners_m: NDArray[np.float64], longest_m: float) -> NDArray[np.float64]:
    """Return stops (s, 2) at every turn of the path through `corners_m` (n, 2), and in between."""
    legs = np.diff(corners_m, axis=0)
    length = np.linalg.norm(legs, axis=1)
    corners = corners_m[np.concatenate([[True], length > 0.0])]
    legs, length = legs[length > 0.0], length[length > 0.0]
    along = legs / length[:, None]
    turns = np.linalg.norm(np.diff(along, axis=0), axis=1) > STRAIGHT_SHARE
    corners = corners[np.concatenate([[True], turns, [True]])] if len(legs) else corners
    stops = [corners[:1]]
    for start, end in pairwise(corners):
        steps = math.ceil(float(np.linalg.norm(end - start)) / longest_m)
        stops.append(start + (end - start) * (np.arange(1, steps + 1) / steps)[:, None])
    return np.concatenate(stops)


def retime(
    start_m: NDArray[np.float64],  # (2,) position of the robot
    path_m: NDArray[np.float64],  # (N, 2) its path; final waiting steps mean arrival
    beyond_m: NDArray[np.float64],  # (b, 2)
    step_m: float,
) -> NDArray[np.float64]:
    """Sample the polyline of a path again, N positions `step_m` apart; ``(N, 2)``."""
    horizon = len(path_m)
    arrived = horizon > 1 and bool((path_m[-1] == path_m[-2]).all())
    line = np.vstack([start_m, path_m] if arrived else [start_m, path_m, beyond_m])
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    line = line[np.concatenate([[True], lengths > 0.0])]
    travelled = np.concatenate([[0.0], lengths[lengths > 0.0].cumsum()])
    total = float(travelled[-1])
    if total == 0.0:
        return path_m
    # Up to rounding, a lattice path of n longest moves takes n steps.
    steps = max(int(np.ceil((total - REACH_TOLERANCE_M) / step_m)), 1)
    if steps <= horizon:
        step_m = total / steps
    stops = np.minimum(step_m * np.arange(1, horizon + 1), total)
    return np.stack(
        [np.interp(stops, travelled, line[:, 0]), np.interp(stops, travelled, line[:, 1])], axis=1
    )
