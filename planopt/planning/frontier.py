"""What to do before a gap in connectivity: measure around it, then give it up for another way.

With the `connected` cost to go the robot is drawn to the cheapest gap between it and the goal. As
long as the bound holds it may not enter; once it stands before the gap and has nothing new to
learn, it would stand there for ever. So it first measures at the unmeasured places near the gap
that keep the bound (each lowers the uncertainty that the bound is tightened by); if the gap is
still there then, it is closed and the next cheapest one draws the robot. A gap that measurements
bring within the bound is none any more, closed or not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kernel import pairwise_distance_m
from planopt.planning.road_map import RoadMap, Ways, way_from

OUT_OF_BOUND_FACTOR = 100.0
"""A metre below the bound counts as this many metres in the `connected` cost to go, so that the
way out of contact is the shortest there is."""
CLOSED_FACTOR = 1e4
"""The same for a closed gap: only if no other way is left."""
GAP_RADIUS_STEPS = 2.0
"""How far about a gap's first node it is measured and closed, in longest steps: a street."""
PROBE_SPACING_STEPS = 0.5
"""Probed places are at least this many longest steps from every measurement."""


class Frontier:
    """Gaps given up, and the one being measured around.

    Parameters
    ----------
    road_map
        The lattice graph.
    step_length_m
        Longest step.
    """

    def __init__(self, road_map: RoadMap, step_length_m: float) -> None:
        self._road_map = road_map
        self._radius_m = GAP_RADIUS_STEPS * step_length_m
        self._spacing_m = PROBE_SPACING_STEPS * step_length_m
        self._closed = np.zeros(len(road_map.nodes_m), dtype=bool)
        self._useless = np.zeros(len(road_map.nodes_m), dtype=bool)
        self._gap_m: NDArray[np.float64] | None = None

    @property
    def probing(self) -> bool:
        """Whether the robot is measuring around a gap."""
        return self._gap_m is not None

    def node_factor(self, outside: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Cost of a metre at each node, given which nodes are below the bound."""
        factor = np.where(outside, OUT_OF_BOUND_FACTOR, 1.0)
        factor[outside & self._closed] = CLOSED_FACTOR
        return factor

    def stand_before_gap(self, ways: Ways, node: int, outside: NDArray[np.bool_]) -> bool:
        """Begin to measure around the first gap on the way from `node`; false if there is none."""
        gap = self._first_gap(ways, node, outside)
        if gap is None:
            return False
        self._gap_m = self._road_map.nodes_m[gap]
        return True

    def still_there(self, ways: Ways, node: int, outside: NDArray[np.bool_]) -> bool:
        """Whether the way from `node` still meets the gap that is being measured around."""
        gap = self._first_gap(ways, node, outside)
        if gap is None or self._gap_m is None:
            return False
        return bool(np.linalg.norm(self._road_map.nodes_m[gap] - self._gap_m) <= self._radius_m)

    def probe(
        self,
        position_m: NDArray[np.float64],
        measured_m: NDArray[np.float64],
        outside: NDArray[np.bool_],
    ) -> int | None:
        """Nearest unmeasured node about the gap that keeps the bound; None if there is none."""
        if self._gap_m is None:
            return None
        nodes_m = self._road_map.nodes_m
        near = np.linalg.norm(nodes_m - self._gap_m, axis=1) <= self._radius_m
        candidates = np.nonzero(near & ~outside & ~self._useless)[0]
        if candidates.size and len(measured_m):
            spacing = pairwise_distance_m(nodes_m[candidates], measured_m).min(axis=1)
            candidates = candidates[spacing >= self._spacing_m]
        if candidates.size == 0:
            return None
        distance = np.linalg.norm(nodes_m[candidates] - position_m, axis=1)
        return int(candidates[np.argmin(distance)])

    def skip(self, node: int) -> None:
        """Give up a probe that cannot be reached within the bound."""
        self._useless[node] = True

    def leave(self) -> None:
        """Stop measuring around the gap: it is open."""
        self._gap_m = None

    def close(self, outside: NDArray[np.bool_]) -> bool:
        """Give the gap up; false if it had been given up before."""
        if self._gap_m is None:
            return False
        near = np.linalg.norm(self._road_map.nodes_m - self._gap_m, axis=1) <= self._radius_m
        closing = near & outside & ~self._closed
        self._closed |= closing
        self._gap_m = None
        return bool(closing.any())

    def _first_gap(self, ways: Ways, node: int, outside: NDArray[np.bool_]) -> int | None:
        way = way_from(self._road_map, ways, node, np.inf)
        gaps = way[outside[way]]
        return int(gaps[0]) if gaps.size else None
