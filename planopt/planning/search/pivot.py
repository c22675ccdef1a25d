"""Pivot: the terminal waypoint that represents the route beyond a path's end (equation 6.6).

The pivot is the farthest visible point of the shortest route; if the path can reach it, a farther
point. Distance plus remaining length never overestimates the route.
"""

from dataclasses import replace

import numpy as np

from planopt.arrays import Floats
from planopt.planning.plan import Pivot
from planopt.planning.scene import Scene, first_moves
from planopt.planning.search.global_search import GlobalStart
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.problems.problem import Problem
from planopt.world.clearance import is_clear, swept_clearance_m
from planopt.world.lattice import lattice_paths, route_from

LOOKAHEAD_STEPS = 5.0
"""Length of the route that is searched for a pivot, in longest steps."""
LATTICE_DETOUR = 0.03
"""Largest relative detour of a lattice path (16 headings: 2.7 %)."""


class Ahead:
    """Route beyond a path's end, represented by a terminal waypoint (pivot)."""

    def __init__(
        self, problem: Problem, scene: Scene, start: GlobalStart, node_margin_db: Floats | None
    ) -> None:
        self._problem = problem
        self._scene = scene
        self._start = start
        self._is_complete = False
        self._node_margin_db = node_margin_db
        self.pivot = self._seen_from(int(start.nodes[-1]), None)
        # The ends of lattice, refined and released path are evaluated repeatedly.
        self._joins: dict[bytes, tuple[int, float, float] | None] = {}
        self._pivots: dict[bytes, Pivot] = {}

    def __call__(self, end_m: Floats) -> Pivot:
        """Return the pivot if it is visible from `end_m` (2,) and cheapest, else a nearby node."""
        key = end_m.tobytes()
        if key not in self._pivots:
            self._pivots[key] = self._cheaper(end_m)
        return self._pivots[key]

    def _cheaper(self, end_m: Floats) -> Pivot:
        problem, pivot = self._problem, self.pivot
        joined = self._joined(end_m)
        if joined is None:
            return pivot
        node, cost_m, metre = joined
        to_pivot = float(np.linalg.norm(pivot.position_m - end_m))
        from_end = float(np.linalg.norm(self._start.path_m[-1] - end_m))
        seen = swept_clearance_m(self._scene.index, np.stack([end_m, pivot.position_m]))
        is_seen = to_pivot == 0.0 or (
            from_end <= problem.step_length_m
            and bool(is_clear(seen, problem.constraints.clearance_m)[0])
        )
        if is_seen and to_pivot * pivot.metre_cost + pivot.cost_m <= cost_m:
            return pivot
        place = self._scene.road_map.nodes_m[node]
        return Pivot(place, float(self._start.cost_to_go.cost_m[node]), metre)

    def leading(self, end_m: Floats) -> Pivot:
        """Return a pivot of the route from `end_m` (2,) that no path of N steps can reach."""
        # With a reachable pivot, a solver could postpone the departure.
        joined = self._joined(end_m)
        return self.pivot if joined is None else self._seen_from(joined[0], end_m)

    def _joined(self, end_m: Floats) -> tuple[int, float, float] | None:
        """Return the cheapest node within a step of `end_m`, its total cost, and the metre cost."""
        key = end_m.tobytes()
        if key not in self._joins:
            self._joins[key] = self._join(end_m)
        return self._joins[key]

    def _join(self, end_m: Floats) -> tuple[int, float, float] | None:
        start = self._start
        nodes, lengths = first_moves(self._scene, self._problem, end_m)
        if not len(nodes):
            return None
        metre = start.metre_cost[nodes]
        metre = 0.5 * (metre + metre[np.argmin(lengths)])
        total = lengths * metre + start.cost_to_go.cost_m[nodes]
        best = int(np.argmin(total))
        if not np.isfinite(total[best]) and not self._is_complete:
            # The search did not expand these nodes.
            cost_to_go = lattice_paths(
                self._scene.road_map, self._scene.goal_node, start.metre_cost
            )
            self._start, self._is_complete = replace(start, cost_to_go=cost_to_go), True
            return self._join(end_m)
        return int(nodes[best]), float(total[best]), float(metre[best])

    def _seen_from(self, node: int, origin_m: Floats | None) -> Pivot:
        problem = self._problem
        return find_pivot(
            self._scene,
            replace(self._start, nodes=np.append(self._start.nodes[:-1], node)),
            self._node_margin_db,
            problem.step_length_m,
            problem.constraints.clearance_m,
            origin_m,
        )


def find_pivot(
    scene: Scene,
    start: GlobalStart,
    node_margin_db: Floats | None,
    step_length_m: float,
    clearance: float,
    origin_m: Floats | None = None,  # (2,)
) -> Pivot:
    """Return the farthest visible route point or, if the path can reach that, a farther one."""
    end = int(start.nodes[-1])
    route = route_from(scene.road_map, start.cost_to_go, end, LOOKAHEAD_STEPS * step_length_m)
    places = scene.road_map.nodes_m[route]
    origin = places[0] if origin_m is None else origin_m
    chosen = 0
    if len(route) > 1:
        # Segments from one origin as one path: origin, p1, origin, p2, ...
        fan = np.empty((2 * (len(route) - 1) + 1, 2))
        fan[0::2] = origin
        fan[1::2] = places[1:]
        seen = is_clear(swept_clearance_m(scene.index, fan)[0::2], clearance)
        farthest_seen = int(np.argmin(seen)) if not seen.all() else len(seen)
        if node_margin_db is not None:
            within = node_margin_db[route] >= MARGIN_PAD_DB
            changed = np.nonzero(within != within[0])[0]
            farthest_seen = min(farthest_seen, int(changed[0]) - 1 if changed.size else len(route))
        ahead = np.linalg.norm(places - origin, axis=1)
        room = LATTICE_DETOUR * len(start.nodes) * step_length_m
        enough = int(np.argmax(ahead >= room)) if ahead.max() >= room else len(ahead) - 1
        chosen = max(farthest_seen, enough)
    cost_m = start.cost_to_go.cost_m
    straight = float(np.linalg.norm(places[chosen] - origin))
    # At the guess's end, the cost via the pivot equals the cost via the lattice.
    joining = float(np.linalg.norm(places[0] - origin)) * float(start.metre_cost[end])
    saved = joining + float(cost_m[end] - cost_m[route[chosen]])
    metre_cost = saved / straight if straight else 1.0
    return Pivot(places[chosen], float(cost_m[route[chosen]]), max(metre_cost, 1.0))
