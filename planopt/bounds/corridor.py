"""Cheapest paths over the corners and side middles of a mesh.

They guide the refinement of the mesh and suggest routes, also through passages that are narrower
than the planner's lattice. No bound depends on them.
"""

from typing import Any, cast

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planopt.arrays import Floats, Indices
from planopt.bounds.mesh import sides_of

Array = Floats

PAIRS = np.array([(i, j) for i in range(6) for j in range(i)]).T
"""All pairs of a triangle's corners and side middles."""


class Corridor:
    """Cheapest paths from the start, node 0, to the goal through triangles of known cost."""

    def __init__(
        self,
        nodes_m: Array,
        corners: Indices,  # (t, 3)
        metre_cost: Array,  # (t,)
        goal_m: Array,
    ) -> None:
        sides, number = np.unique(sides_of(corners), axis=0, return_inverse=True)
        points = np.vstack([nodes_m, nodes_m[sides].mean(axis=1)])
        knots = np.column_stack([corners, len(nodes_m) + number.reshape(3, -1).T])
        self._points_m, self._used = points, np.unique(knots)
        one, other = (knots[:, pair].ravel() for pair in PAIRS)
        cost = np.linalg.norm(points[one] - points[other], axis=1)
        cost *= np.repeat(metre_cost, PAIRS.shape[1])
        # A side belongs to two triangles, of which the cheaper one counts.
        key = np.maximum(one, other) * len(points) + np.minimum(one, other)
        order = np.lexsort([cost, key])
        first = order[np.diff(key[order], prepend=-1) > 0]
        edges = (cost[first], (one[first], other[first]))
        graph = sparse.coo_array(edges, shape=(len(points),) * 2).tocsr()
        ends = [0, self._nearest(goal_m)]
        search = cast("Any", csgraph.dijkstra)  # pyright: ignore
        cost_m: Array
        self._next: Indices
        cost_m, self._next = search(graph, directed=False, indices=ends, return_predecessors=True)
        # Relative excess cost of the cheapest path through each triangle; (t,)
        through = cost_m.sum(axis=0)[knots].min(axis=1)
        self.excess = through / cost_m[0, ends[1]] - 1.0
        self.is_connected = bool(np.isfinite(cost_m[0, ends[1]]))

    def _nearest(self, place_m: Array) -> int:
        away = np.linalg.norm(self._points_m[self._used] - place_m, axis=1)
        return int(self._used[away.argmin()])

    def path_m(self, start_m: Array) -> Array:
        """Return the points (n, 2) of the cheapest path from near `start_m` (2,) to the goal."""
        point, path = self._nearest(start_m), list[int]()
        while point >= 0:
            path.append(point)
            point = int(self._next[1, point])
        return self._points_m[path]
