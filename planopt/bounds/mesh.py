"""Delaunay meshes of the workspace that resolve the boundaries of obstacles, and paths on them.

Cheapest paths over corners and side middles guide the refinement of the mesh and suggest routes,
also through passages that are narrower than the planner's lattice. No bound depends on them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import shapely
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import Delaunay

from planopt.arrays import Floats, Indices, Mask

FIRST_NODES = 500  # Number of grid nodes of the first mesh, without the nodes on obstacles
DEPTH_SHARE = 3e-4
"""Depth of mesh borders inside obstacles, as a share of the workspace diagonal. It leaves room to
simplify the borders."""
DEPTHS_M = (1e-3, 0.3)
"""Smallest and largest depth of mesh borders inside obstacles; thin obstacles get less."""
SNAP_M = 1e-7  # Nodes within this distance of the workspace boundary are moved onto it
MAX_SPLITS = 40
"""Maximum rounds of border splitting. Borders not on triangle sides by then loosen the bound."""
AREA_TOLERANCE = 1e-9  # Relative rounding tolerance of the area of a mesh


@dataclass
class Mesh:
    """Delaunay triangulation of the workspace that is refined by adding nodes."""

    nodes_m: Floats  # (n, 2); node 0 is the start
    borders: Indices  # (m, 2) end nodes of the border segments
    # Cached by the triangle's node numbers: least costs at its corners, cost at its centre; None
    # inside a blocked area
    known: dict[tuple[int, ...], tuple[float, float, float, float] | None] = field(
        default_factory=dict[tuple[int, ...], tuple[float, float, float, float] | None]
    )

    def triangles(self) -> Indices:
        """Halve borders until they are sides; return triangles (t, 3) as ascending node numbers."""
        corners = np.empty((0, 3), dtype=np.intp)
        for _ in range(MAX_SPLITS):
            corners = np.sort(np.asarray(Delaunay(self.nodes_m).simplices, dtype=np.intp), axis=1)
            sides = np.unique(sides_of(corners) @ (len(self.nodes_m), 1))
            missing = ~np.isin(np.sort(self.borders, axis=1) @ (len(self.nodes_m), 1), sides)
            if not missing.any():
                break
            self.split(missing)
        return corners

    def split(self, chosen: Mask) -> None:
        """Halve the border segments that the mask `chosen` selects."""
        ends = self.borders[chosen]
        middle = len(self.nodes_m) + np.arange(len(ends))
        self.nodes_m = np.vstack([self.nodes_m, self.nodes_m[ends].mean(axis=1)])
        halves = [np.column_stack([ends[:, 0], middle]), np.column_stack([middle, ends[:, 1]])]
        self.borders = np.vstack([self.borders[~chosen], *halves])

    def refine(self, chosen: Indices) -> int:
        """Halve the sides of triangles `chosen` (k, 3); return the number of new nodes."""
        sides = np.unique(sides_of(chosen), axis=0)
        keys = sides @ (len(self.nodes_m), 1)
        borders = np.sort(self.borders, axis=1) @ (len(self.nodes_m), 1)
        inner, on_border = ~np.isin(keys, borders), np.isin(borders, keys)
        middles = self.nodes_m[sides[inner]].mean(axis=1)
        self.split(on_border)
        self.nodes_m = np.vstack([self.nodes_m, middles])
        return len(middles) + int(on_border.sum())


def sides_of(corners: Indices) -> Indices:
    """Return the sides of triangles (t, 3) as pairs of end nodes as an array (3 t, 2)."""
    return np.vstack([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [0, 2]]])


def first_mesh(
    bounds_m: tuple[float, float, float, float],
    blocked: Sequence[shapely.Polygon],
    start_m: Floats,
    goal_m: Floats,
    goal_radius_m: float,
) -> Mesh:
    """Return a mesh with nodes at the start, on a grid and on all boundaries."""
    x0, y0, x1, y1 = bounds_m
    spacing = np.sqrt((x1 - x0) * (y1 - y0) / FIRST_NODES)
    columns, rows = (max(2, round(side / spacing) + 1) for side in (x1 - x0, y1 - y0))
    grid = np.stack(np.meshgrid(np.linspace(x0, x1, columns), np.linspace(y0, y1, rows)), axis=-1)
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    circle = goal_m + 1.01 * goal_radius_m / np.cos(np.pi / 24) * circle
    loose = np.vstack([grid.reshape(-1, 2), circle])
    apart = 0.2 * np.repeat([spacing, goal_radius_m], [columns * rows, len(circle)])
    is_inside = ((loose >= (x0, y0)) & (loose <= (x1, y1))).all(axis=1)
    loose, apart = loose[is_inside], apart[is_inside]
    depth = float(np.clip(DEPTH_SHARE * np.hypot(x1 - x0, y1 - y0), *DEPTHS_M))
    inner = shapely.get_parts([inside_of(polygon, depth) for polygon in blocked])
    near, _ = shapely.STRtree(inner).query(
        shapely.points(loose), predicate="dwithin", distance=apart
    )
    corner = np.isin(loose, [x0, x1])[:, 0] & np.isin(loose, [y0, y1])[:, 1]
    dropped = np.isin(np.arange(len(loose)), near) & ~corner
    nodes = [start_m[None], loose[~dropped]]
    borders: list[Indices] = []
    count = sum(map(len, nodes))
    region = shapely.box(*bounds_m)
    for polygon in shapely.get_parts(shapely.intersection(inner, region)):
        if not isinstance(polygon, shapely.Polygon):
            continue
        for ring in (polygon.exterior, *polygon.interiors):
            dense: Any = shapely.segmentize(ring, spacing)  # pyright: ignore
            corners: Floats = shapely.get_coordinates(dense)[:-1]  # pyright: ignore
            own = count + np.arange(len(corners))
            borders.append(np.column_stack([own, np.roll(own, -1)]))
            nodes.append(corners)
            count += len(corners)
    merged, first, number = np.unique(
        np.round(np.vstack(nodes), 9), axis=0, return_index=True, return_inverse=True
    )
    for axis, (low, high) in enumerate(((x0, x1), (y0, y1))):
        for value in (low, high):
            merged[np.abs(merged[:, axis] - value) < SNAP_M, axis] = value
    merged[number.ravel()[0]] = start_m
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    ends = rank[number.ravel()[np.vstack(borders)]] if borders else np.empty((0, 2), dtype=np.intp)
    ends = np.unique(np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1), axis=0)
    return Mesh(merged[order], ends)


def inside_of(polygon: shapely.Polygon, depth_m: float) -> shapely.Geometry:
    """Return a simplified area inside a polygon, at most about 2 `depth_m` from its boundary."""
    while depth_m > DEPTHS_M[0]:
        simple = polygon.buffer(-depth_m).simplify(0.9 * depth_m)
        if simple.area > 0.8 * polygon.area and polygon.covers(simple):
            return simple
        depth_m *= 0.25
    return polygon.buffer(-DEPTHS_M[0])


def covers_bounds(
    nodes_m: Floats, corners: Indices, bounds_m: tuple[float, float, float, float]
) -> bool:
    """Return whether triangles (t, 3) tile the workspace and share whole sides."""
    # Then node values define a continuous function.
    x0, y0, x1, y1 = bounds_m
    if not (nodes_m >= (x0, y0)).all() or not (nodes_m <= (x1, y1)).all():
        return False
    sides, number = np.unique(sides_of(np.sort(corners, axis=1)), axis=0, return_counts=True)
    if (number > 2).any():
        return False
    ends = nodes_m[sides[number == 1]]
    on_border = np.zeros(len(ends), dtype=bool)
    for axis, values in ((0, (x0, x1)), (1, (y0, y1))):
        for value in values:
            on_border |= (ends[:, :, axis] == value).all(axis=1)
    area = np.abs(doubled_areas(nodes_m, corners)).sum() / 2.0
    whole = (x1 - x0) * (y1 - y0)
    return bool(on_border.all()) and abs(area - whole) <= AREA_TOLERANCE * whole


def doubled_areas(nodes_m: Floats, corners: Indices) -> Floats:
    """Return twice the signed areas of triangles (t, 3)."""
    a, b, c = (nodes_m[corners[:, i]] for i in range(3))
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def enclosing_discs(corners_m: Floats) -> tuple[Floats, Floats]:
    """Return centres and radii of the smallest discs that contain triangles (t, 3, 2)."""
    a, b, c = corners_m[:, 0], corners_m[:, 1], corners_m[:, 2]
    lengths = np.linalg.norm(np.stack([b - c, c - a, a - b], axis=1), axis=2)
    longest = lengths.argmax(axis=1)
    rows = np.arange(len(a))
    middles = np.stack([b + c, c + a, a + b], axis=1) / 2.0
    centre = middles[rows, longest]
    radius = lengths[rows, longest] / 2.0
    outside = np.linalg.norm(corners_m[rows, longest] - centre, axis=1) > radius
    u, v = b - a, c - a
    double = 2.0 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    uu, vv = (u**2).sum(axis=1), (v**2).sum(axis=1)
    across = np.column_stack([v[:, 1] * uu - u[:, 1] * vv, u[:, 0] * vv - v[:, 0] * uu])
    with np.errstate(divide="ignore", invalid="ignore"):
        about = a + across / double[:, None]
    centre = np.where(outside[:, None], about, centre)
    radius = np.linalg.norm(corners_m - centre[:, None], axis=2).max(axis=1)
    return centre, radius * (1.0 + 1e-9)


PAIRS = np.array([(i, j) for i in range(6) for j in range(i)]).T
"""All pairs of a triangle's corners and side middles."""


class Corridor:
    """Cheapest paths from the start, node 0, to the goal through triangles of known cost."""

    def __init__(
        self,
        nodes_m: Floats,
        corners: Indices,  # (t, 3)
        metre_cost: Floats,  # (t,)
        goal_m: Floats,
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
        graph = sparse.coo_array(edges, shape=(len(points), len(points))).tocsr()
        ends = [0, self._nearest(goal_m)]
        search = cast("Any", csgraph.dijkstra)
        cost_m: Floats
        self._next: Indices
        cost_m, self._next = search(graph, directed=False, indices=ends, return_predecessors=True)
        least_m = float(cost_m[0, ends[1]])
        self.is_connected = 0.0 < least_m < np.inf  # Not if the start is at the goal
        # Relative excess cost of the cheapest path through each triangle; (t,)
        through = cost_m.sum(axis=0)[knots].min(axis=1)
        self.excess = through / least_m - 1.0 if self.is_connected else through

    def _nearest(self, place_m: Floats) -> int:
        away = np.linalg.norm(self._points_m[self._used] - place_m, axis=1)
        return int(self._used[away.argmin()])

    def path_m(self, start_m: Floats) -> Floats:
        """Return the points (n, 2) of the cheapest path from near `start_m` (2,) to the goal."""
        point, path = self._nearest(start_m), list[int]()
        while point >= 0:
            path.append(point)
            point = int(self._next[1, point])
        return self._points_m[path]
