"""Paths along the lattice, pulled taut and timed.

A lattice path moves at the speeds that its moves happen to have. Separating lines belong to
segments, so a path that passes a corner a step late keeps its refinement late too. Sampled again at
cruising speed (:func:`retime`) it passes the corner in time.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planopt.planning.scene import Ground, first_moves
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.problems.problem import Problem
from planopt.world.clearance import segments_clear
from planopt.world.lattice import REACH_TOLERANCE_M, CostToGo, lattice_paths, route_from

STRAIGHT_SHARE = 1e-9
"""Legs turn where their directions differ by more than this."""


class WaysFrom:
    """Ways from one place to all nodes of a lattice that can be come to."""

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
        """Return whether the straight way to each place (n, 2) is clear."""
        starts = np.broadcast_to(self._position_m, places_m.shape)
        return segments_clear(self._ground.index, starts, places_m, self._wanted_m)

    def turns_m(self, node: int, end_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return turns of the way to a place (2,) beside `node`, its start and its end; (m, 2)."""
        if self._ways is None:
            raise AssertionError("there is no way to any node")
        nodes = route_from(self._ground.road_map, self._ways, node, math.inf)[::-1]
        corners = np.vstack([self._position_m, self._ground.road_map.nodes_m[nodes], end_m])
        turns, last = [corners[0]], 0
        while last < len(corners) - 1:
            ahead = corners[last + 1 :]
            starts = np.broadcast_to(corners[last], ahead.shape)
            clear = segments_clear(self._ground.index, starts, ahead, self._wanted_m)
            seen = np.flatnonzero(clear)
            # The next node is a move away, if the clearance is missed where the robot stands.
            last += 1 + (int(seen[-1]) if len(seen) else 0)
            turns.append(corners[last])
        return np.array(turns)


def stops_along(corners_m: NDArray[np.float64], longest_m: float) -> NDArray[np.float64]:
    """Stops at every turn of the way through `corners_m` (n, 2), and evenly between; (s, 2)."""
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
    start_m: NDArray[np.float64],  # (2,) where the robot is
    path_m: NDArray[np.float64],  # (N, 2) its path; where it stands still at its end it has arrived
    beyond_m: NDArray[np.float64],  # (b, 2)
    step_m: float,
) -> NDArray[np.float64]:
    """Sample the way of a path anew, N places `step_m` apart."""
    # Shapes: returns (N, 2).
    horizon = len(path_m)
    arrived = horizon > 1 and bool((path_m[-1] == path_m[-2]).all())
    way = np.vstack([start_m, path_m] if arrived else [start_m, path_m, beyond_m])
    lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
    way = way[np.concatenate([[True], lengths > 0.0])]
    travelled = np.concatenate([[0.0], lengths[lengths > 0.0].cumsum()])
    total = float(travelled[-1])
    if total == 0.0:
        return path_m
    # A lattice path of n longest moves is n steps long but for rounding, and takes n steps.
    steps = max(int(np.ceil((total - REACH_TOLERANCE_M) / step_m)), 1)
    if steps <= horizon:
        step_m = total / steps
    stops = np.minimum(step_m * np.arange(1, horizon + 1), total)
    return np.stack(
        [np.interp(stops, travelled, way[:, 0]), np.interp(stops, travelled, way[:, 1])], axis=1
    )
