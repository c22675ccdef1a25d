"""The way beyond the horizon as one point of it: cost to go that a solver can differentiate.

Round obstacles the shortest way from q is straight up to some corner: its length is the distance to
any visible point of the way plus the length from there. The farthest visible point is the pivot,
unless the path could come to it and beyond: then a farther point is, seen or not. Distance plus
length never overestimates the way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.ground import first_moves
from planopt.planning.plan import Pivot
from planopt.planning.scene import Scene
from planopt.planning.search.global_search import GlobalStart
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.problems.problem import Problem
from planopt.world.clearance import is_clear, swept_clearance_m
from planopt.world.road_map import way_from

LOOKAHEAD_STEPS = 5.0
"""How far along the way a pivot is sought, in longest steps."""
LATTICE_DETOUR = 0.03
"""A lattice path is at most this share longer than the straight one (16 headings: 2.7 %). The pivot
lies at least that far ahead, or a polished path would come to it and have nowhere to go."""


class Ahead:
    """The rest of the way from wherever a path ends, as a pivot.

    Parameters
    ----------
    problem, scene, start
        What is planned, where, and the cost-to-go.
    pivot
        That counts for places near the start path's end which see it. Farther off, what lies
        between may cost more than the straight line to it.
    """

    def __init__(self, problem: Problem, scene: Scene, start: GlobalStart, pivot: Pivot) -> None:
        self._problem = problem
        self._scene = scene
        self._start = start
        self._pivot = pivot

    def __call__(self, end_m: NDArray[np.float64]) -> Pivot:
        """The cheaper of the pivot, if it is seen from `end_m` (2,), and nodes within a step.

        The pivot, seen or not, where there is no node.
        """
        problem, start, pivot = self._problem, self._start, self._pivot
        to_pivot = float(np.linalg.norm(pivot.position_m - end_m))
        from_end = float(np.linalg.norm(start.path_m[-1] - end_m))
        seen = swept_clearance_m(self._scene.index, np.stack([end_m, pivot.position_m]))
        is_seen = to_pivot == 0.0 or (
            from_end <= problem.step_length_m
            and bool(is_clear(seen, problem.constraints.clearance_m)[0])
        )
        nodes, lengths = first_moves(self._scene.ground, problem, end_m)
        if not len(nodes):
            return pivot
        metre = start.metre_cost[nodes]
        metre = 0.5 * (metre + metre[np.argmin(lengths)])
        total = lengths * metre + start.ways.cost_m[nodes]
        best = int(np.argmin(total))
        if is_seen and to_pivot * pivot.metre_cost + pivot.cost_m <= total[best]:
            return pivot
        place = self._scene.road_map.nodes_m[nodes[best]]
        return Pivot(place, float(start.ways.cost_m[nodes[best]]), float(metre[best]))


def find_pivot(
    scene: Scene,
    start: GlobalStart,
    node_margin_db: NDArray[np.float64] | None,
    step_length_m: float,
    clearance: float,
    origin_m: NDArray[np.float64] | None = None,
) -> Pivot:
    """Farthest point of the way that is seen from the start path's end, or one out of reach.

    Parameters
    ----------
    scene, start
        Where, and the start path with its cost to go.
    node_margin_db
        Margins of all nodes if the way must keep the bound: then no place seen lies beyond a
        change between within and below it. None if it need not.
    step_length_m, clearance
        Longest step, and the clearance that a line of sight must keep.
    origin_m
        ``(2,)`` where the pivot must be seen from; None for the start path's end.
    """
    end = int(start.nodes[-1])
    way = way_from(scene.road_map, start.ways, end, LOOKAHEAD_STEPS * step_length_m)
    if node_margin_db is not None:
        within = node_margin_db[way] >= MARGIN_PAD_DB
        changed = np.nonzero(within != within[0])[0]
        way = way[: changed[0]] if changed.size else way
    places = scene.road_map.nodes_m[way]
    chosen = 0
    if len(way) > 1:
        origin = places[0] if origin_m is None else origin_m
        # Fan of segments from there to each place, as one path origin, p1, origin, p2, ...
        fan = np.empty((2 * (len(way) - 1) + 1, 2))
        fan[0::2] = origin
        fan[1::2] = places[1:]
        seen = is_clear(swept_clearance_m(scene.index, fan)[0::2], clearance)
        farthest_seen = int(np.argmin(seen)) if not seen.all() else len(seen)
        ahead = np.linalg.norm(places - origin, axis=1)
        room = LATTICE_DETOUR * len(start.nodes) * step_length_m
        enough = int(np.argmax(ahead >= room)) if ahead.max() >= room else len(ahead) - 1
        chosen = max(farthest_seen, enough)
    cost_m = start.ways.cost_m
    straight = float(np.linalg.norm(places[chosen] - places[0]))
    # From the lattice path's end both ways of counting agree, whatever lies between.
    metre_cost = float(cost_m[end] - cost_m[way[chosen]]) / straight if straight else 1.0
    return Pivot(places[chosen], float(cost_m[way[chosen]]), max(metre_cost, 1.0))
