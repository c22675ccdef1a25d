"""What to do before a gap in connectivity: measure around it, then give it up for another way.

With the `connected` cost to go the robot is drawn to the cheapest gap between it and the goal. As
long as the bound holds it may not enter; once it stands before the gap and has nothing new to
learn, it would stand there for ever. So it first measures at the unmeasured places near the gap
that keep the bound (each lowers the uncertainty that the bound is tightened by); if the gap is
still there then, it is closed and the next cheapest one draws the robot. A gap that measurements
bring within the bound is none any more, closed or not. When every gap is closed, no way to the goal
keeps the bound, and the cheapest one is crossed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kernel import pairwise_distance_m
from planopt.planning.search.road_map import RoadMap, Ways, way_from

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
        self._gap_m: NDArray[np.float64] | None = None
        self._crossing = False
        self._entered = False

    @property
    def probing(self) -> bool:
        """Whether the robot is measuring around a gap."""
        return self._gap_m is not None

    @property
    def crossing(self) -> bool:
        """Whether the robot is crossing a gap, because no way is left that keeps the bound."""
        return self._crossing

    def cross(self) -> None:
        """Begin to cross the cheapest gap."""
        self._gap_m = None
        self._crossing, self._entered = True, False

    def follow(self, is_outside: bool) -> None:
        """Note whether the robot is below the bound now: a gap ends where it comes out again."""
        if self._crossing and self._entered and not is_outside:
            self._crossing = False
        self._entered = self._crossing and is_outside

    def node_factor(self, outside: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Cost of a metre at each node, given which nodes are below the bound."""
        factor = np.where(outside, OUT_OF_BOUND_FACTOR, 1.0)
        if not self._crossing:
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
        from_here: Ways,
        measured_m: NDArray[np.float64],
        outside: NDArray[np.bool_],
    ) -> int | None:
        """Nearest unmeasured node about the gap that keeps the bound; None if there is none.

        Parameters
        ----------
        from_here
            Ways between the robot's place and every node, the bound's factors included.
        measured_m
            ``(m, 2)`` measured places.
        outside
            ``(n,)`` nodes below the bound.
        """
        if self._gap_m is None:
            return None
        nodes_m = self._road_map.nodes_m
        near = np.linalg.norm(nodes_m - self._gap_m, axis=1) <= self._radius_m
        # A way that costs as much as a metre below the bound may well be one.
        within = from_here.cost_m < OUT_OF_BOUND_FACTOR
        candidates = np.nonzero(near & ~outside & within)[0]
        away = np.abs(measured_m - self._gap_m).max(axis=1, initial=0.0)
        beside = measured_m[away <= self._radius_m + self._spacing_m]
        if candidates.size and len(beside):
            spacing = pairwise_distance_m(nodes_m[candidates], beside).min(axis=1)
            candidates = candidates[spacing >= self._spacing_m]
        if candidates.size == 0:
            return None
        return int(candidates[np.argmin(from_here.cost_m[candidates])])

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
