"""Coverage of regions that are not convex or hold obstacles, by shortest distances.

Shortest paths turn only at corners that stand out into the free area. The distances between those
corners, and which of them each node of a grid sees, are found once; then the distance of any agent
to any node is exact, and so is the cost: ``H = sum of mass * d(p_i, q)^2 + spread``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra  # pyright: ignore[reportUnknownVariableType]
from scipy.spatial import KDTree

from planopt.coverage.density import UNIFORM, Density, UniformDensity
from planopt.coverage.region import checked_polygon, positive
from planopt.coverage.voronoi import Boundary
from planopt.errors import InputError
from planopt.world.shortest_paths import corners_m

SLACK = 1e-9
"""Places may be outside by this share of the extent, for rounding; sight lines by twice as much."""

SLIVER = 1e-6
"""Free parts that are smaller than this share of a grid square are left out."""

MAX_NODES = 200_000
"""More nodes take minutes to look from: the spacing is a mistake."""


@dataclass(frozen=True, eq=False)
class GeodesicRegion:
    """A free area with nodes that stand for it; :func:`geodesic_region` builds it."""

    # The outline less the obstacles: what is covered, and where paths may lead
    free: shapely.Polygon
    allowed: shapely.Polygon  # The part of it that keeps the clearance: where agents may be
    slack_m: float  # How far outside a place still counts as on the border, for rounding
    # Borders of both, grown by more than that: a straight line between two places of the area that
    # meets its border leaves the area
    free_border: shapely.Geometry
    allowed_border: shapely.Geometry
    # (m, 2) places that stand for the parts of the free area, one for each grid square or each
    # piece of one that obstacles cut
    nodes_m: NDArray[np.float64]
    mass: NDArray[np.float64]  # (m,) mass of each part
    # Coverage cost if every node had its own agent: what the parts cost about their own nodes
    spread: float
    corners_m: NDArray[np.float64]  # (c, 2) corners at which shortest paths may turn
    between_m: NDArray[np.float64]  # (c, c) shortest distances between them
    # (m, c) whether the straight line from the node to the corner is free
    corner_sees: NDArray[np.bool_]

    def contains(self, places_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether places ``(k, 2)`` are in the free area or on its border; (k,)."""
        return _near(self.free, places_m, self.slack_m)

    def nearest(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places ``(k, 2)`` as they are if they are free, else the nearest free places."""
        moved = np.array(places_m, dtype=np.float64)
        for which in np.flatnonzero(~self.contains(moved)):
            moved[which] = nearest_place(self.free, moved[which])
        return moved

    def sees(self, starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether the straight lines between free places ``(k, 2)`` are free; (k,)."""
        return ~_meets(self.free_border, starts_m, ends_m)

    def sees_each(
        self, places_m: NDArray[np.float64], others_m: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Return whether each of ``(k, 2)`` free places sees each of ``(l, 2)``; (k, l)."""
        count, other = len(places_m), len(others_m)
        starts, ends = np.repeat(places_m, other, axis=0), np.tile(others_m, (count, 1))
        return self.sees(starts, ends).reshape(count, other)

    def allows(
        self, starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Return whether agents may drive straight from places to others, ``(k, 2)`` each; (k,)."""
        inside = _near(self.allowed, ends_m, self.slack_m)
        return inside & ~_meets(self.allowed_border, starts_m, ends_m)


def geodesic_region(
    outline: shapely.Polygon | NDArray[np.float64],
    obstacles: Sequence[shapely.Polygon],
    spacing_m: float,
    density: Density = UNIFORM,
    clearance_m: float = 0.0,
) -> GeodesicRegion:
    """Prepare a region with obstacles, convex or not, for coverage by shortest distances."""
    whole = checked_polygon(outline)
    positive(spacing_m, "spacing_m")
    positive(clearance_m, "clearance_m", zero=True)
    free = _in_one_part(whole, obstacles)
    allowed = _shrunk(free, clearance_m)
    extent = float(np.ptp(np.asarray(free.bounds).reshape(2, 2), axis=0).max())
    nodes, mass, spread = _nodes(free, spacing_m, density)
    slack = SLACK * extent
    free_border, allowed_border = (_grown_border(area, 2.0 * slack) for area in (free, allowed))
    corners = np.unique(corners_m(np.array([free]), free=True), axis=0)
    count = len(corners)
    between, seen = np.zeros((count, count)), np.zeros((len(nodes), count), dtype=np.bool_)
    region = GeodesicRegion(
        free,
        allowed,
        slack,
        free_border,
        allowed_border,
        nodes,
        mass,
        spread,
        corners,
        between,
        seen,
    )
    if not count:
        return region
    straight = np.linalg.norm(corners[:, None] - corners, axis=2)
    straight[~region.sees_each(corners, corners)] = 0.0
    between = np.asarray(dijkstra(straight), dtype=np.float64)
    return replace(region, between_m=between, corner_sees=region.sees_each(nodes, corners))


def _in_one_part(whole: shapely.Polygon, obstacles: Sequence[shapely.Polygon]) -> shapely.Polygon:
    """Return the region without obstacles, checked to be connected."""
    left: shapely.Geometry = whole
    for number, obstacle in enumerate(obstacles):
        if not (shapely.is_valid(obstacle) and obstacle.area > 0.0):
            raise InputError("the outline is not simple", key=f"obstacles[{number}]")
        left = left.difference(obstacle)
    parts = _parts(left)
    if not parts:
        raise InputError(
            "obstacles leave nothing of the region", key="obstacles", remedy="leave some out"
        )
    if len(parts) > 1:
        areas = ", ".join(f"{part.area:.4g}" for part in parts)
        raise InputError(
            f"obstacles cut the region into {len(parts)} parts of {areas} m^2",
            key="obstacles",
            remedy="cover each part as a region of its own",
        )
    return shapely.orient_polygons(parts[0])


def _shrunk(free: shapely.Polygon, clearance_m: float) -> shapely.Polygon:
    """The part of an area that keeps a clearance, checked to be connected."""
    if clearance_m == 0.0:
        return free
    parts = _parts(free.buffer(-clearance_m, join_style="mitre"))
    if len(parts) != 1:
        raise InputError(
            f"a clearance of {clearance_m:g} m leaves {len(parts)} parts of the region",
            key="clearance_m",
            remedy="give a smaller one",
        )
    return shapely.orient_polygons(parts[0])


def _grown_border(area: shapely.Polygon, by_m: float) -> shapely.Geometry:
    """The border of an area grown a little, both prepared for many queries."""
    border = shapely.boundary(shapely.buffer(area, by_m, join_style="mitre"))
    shapely.prepare(area)
    shapely.prepare(border)
    return border


def _parts(area: shapely.Geometry) -> list[shapely.Polygon]:
    """The polygons that an area consists of."""
    parts = shapely.get_parts(area).tolist()
    return [part for part in parts if isinstance(part, shapely.Polygon) and part.area > 0.0]


def _nodes(
    free: shapely.Polygon, spacing_m: float, density: Density
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Nodes (m, 2), their masses (m,) and what the parts cost about them."""
    x_min, y_min, x_max, y_max = free.bounds
    columns = math.ceil((x_max - x_min) / spacing_m)
    rows = math.ceil((y_max - y_min) / spacing_m)
    if columns * rows > MAX_NODES:
        raise InputError(
            f"a spacing of {spacing_m:g} m gives {columns * rows} nodes",
            key="spacing_m",
            remedy=f"at most {MAX_NODES} are allowed",
        )
    row, column = np.divmod(np.arange(rows * columns), columns)
    left, low = x_min + spacing_m * column, y_min + spacing_m * row
    squares = np.asarray(
        shapely.box(left, low, left + spacing_m, low + spacing_m), dtype=np.object_
    )
    shapely.prepare(free)
    inside = np.asarray(shapely.contains(free, squares), dtype=np.bool_)
    cut = np.asarray(shapely.intersection(squares[~inside], free), dtype=np.object_)
    pieces = np.concatenate((squares[inside], shapely.get_parts(cut)))
    area = np.asarray(shapely.area(pieces))  # pyright: ignore[reportUnknownMemberType]
    pieces = pieces[area > SLIVER * spacing_m**2]
    nodes = np.asarray(shapely.get_coordinates(shapely.centroid(pieces)), dtype=np.float64)
    out = ~np.asarray(shapely.intersects(pieces, shapely.points(nodes)), dtype=np.bool_)
    if out.any():
        nodes[out] = shapely.get_coordinates(shapely.point_on_surface(pieces[out]))
    weight = density.at(nodes)
    moments = UniformDensity().moments(_boundaries(pieces, nodes))
    mass = weight * moments.mass
    if not mass.sum() > 0.0:
        raise InputError("the density is zero all over the region", key="density")
    return nodes, mass, float(weight @ moments.second)


def _boundaries(pieces: NDArray[np.object_], nodes_m: NDArray[np.float64]) -> Boundary:
    """Boundaries of polygons (m,) about places (m, 2): signed parts, so that holes subtract."""
    rings, piece = shapely.get_rings(shapely.orient_polygons(pieces), return_index=True)
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    cell = piece[ring]
    same = ring[1:] == ring[:-1]
    spokes = corners - nodes_m[cell]
    none = np.zeros(int(same.sum()))
    return Boundary(nodes_m, cell[:-1][same], spokes[:-1][same], spokes[1:][same], none)


def _meets(
    border: shapely.Geometry, starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return whether straight lines between places (k, 2) meet a border; (k,)."""
    lines = shapely.linestrings(np.stack((starts_m, ends_m), axis=1))
    return np.asarray(shapely.intersects(border, lines), dtype=np.bool_)


def nearest_place(area: shapely.Polygon, place_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the place of an area that is nearest to a place (2,)."""
    link = shapely.shortest_line(area, shapely.Point(place_m))  # pyright: ignore[reportUnknownMemberType]
    return np.asarray(shapely.get_coordinates(link), dtype=np.float64)[0]


def _near(
    area: shapely.Polygon, places_m: NDArray[np.float64], within_m: float
) -> NDArray[np.bool_]:
    """Return whether places (k, 2) are in an area or at most a distance from it; (k,)."""
    return np.asarray(shapely.dwithin(area, shapely.points(places_m), within_m), dtype=np.bool_)


HALVINGS = 8
"""How often a step is halved until it lowers the cost of the agent's own cell."""

AT_CORNER = 1e-9
"""A corner nearer than this share of the region's extent is where the agent stands."""


@dataclass(frozen=True, eq=False)
class GeodesicCells:
    """The agent nearest to each node by the shortest path."""

    # (m,) number of the nearest agent; the smallest number of agents at one place
    owner: NDArray[np.intp]
    distance_m: NDArray[np.float64]  # (m,) length of the shortest path to it
    # (m, 2) unit vector in which that path leaves the agent; 0 where they coincide
    direction: NDArray[np.float64]
    cost: float  # The coverage cost H
    mass: NDArray[np.float64]  # (n,) mass of each agent's cell
    gradient: NDArray[np.float64]  # (n, 2) derivative of H by each agent's place


@dataclass(frozen=True, eq=False)
class _Corners:
    """Shortest ways from agents to the region's corners."""

    length_m: NDArray[np.float64]  # (n, c) lengths; infinite if the agent sees no corner
    first: NDArray[np.intp]  # (n, c) the corner that the way passes first


def geodesic_cells(region: GeodesicRegion, agents_m: NDArray[np.float64]) -> GeodesicCells:
    """Divide the nodes of a region among agents, and evaluate the coverage cost."""
    # Shapes: agents_m (n, 2).
    agents = _checked(region, agents_m)
    corners = _to_corners(region, agents)
    nodes, count = region.nodes_m, len(agents)
    distance = np.full(len(nodes), np.inf)
    owner = np.zeros(len(nodes), dtype=np.intp)
    turn = np.full(len(nodes), -1, dtype=np.intp)
    if len(region.corners_m):
        # Beyond a corner only the agent that is nearest to it matters.
        best = corners.length_m.argmin(axis=0)
        reach = corners.length_m[best, np.arange(len(best))]
        through = reach + np.linalg.norm(nodes[:, None] - region.corners_m, axis=2)
        through[~region.corner_sees] = np.inf
        turn = through.argmin(axis=1)
        distance = through[np.arange(len(nodes)), turn]
        owner = best[turn]
    # Straight lines, to the nearest agents first, as long as they may be shorter.
    tree, waiting = KDTree(agents), np.arange(len(nodes))
    near, fetched = np.zeros((len(nodes), 0), dtype=np.intp), 0
    for rank in range(count):
        if rank >= fetched:
            fetched = min(count, max(4, 2 * fetched))
            near = np.zeros((len(nodes), fetched), dtype=np.intp)
            near[waiting] = _nearest(tree, nodes[waiting], fetched)
        agent = near[waiting, rank]
        straight = np.linalg.norm(nodes[waiting] - agents[agent], axis=1)
        # Straight also where a way over the corner that the agent stands on is as long.
        kept = straight <= distance[waiting] * (1.0 + AT_CORNER)
        waiting, agent, straight = waiting[kept], agent[kept], straight[kept]
        if not len(waiting):
            break
        seen = region.sees(agents[agent], nodes[waiting])
        found = waiting[seen]
        owner[found], distance[found], turn[found] = agent[seen], straight[seen], -1
        waiting = waiting[~seen]
    toward = nodes - agents[owner]
    bent = turn >= 0
    toward[bent] = region.corners_m[corners.first[owner[bent], turn[bent]]] - agents[owner[bent]]
    length = np.linalg.norm(toward, axis=1)
    direction = toward / np.where(length > 0.0, length, 1.0)[:, None]
    pull = 2.0 * region.mass * distance
    gradient = np.zeros((count, 2))
    for axis in range(2):
        gradient[:, axis] -= np.bincount(owner, pull * direction[:, axis], minlength=count)
    cost = float(region.mass @ distance**2) + region.spread
    mass = np.asarray(np.bincount(owner, region.mass, minlength=count), dtype=np.float64)
    return GeodesicCells(owner, distance, direction, cost, mass, gradient)


def geodesic_targets(
    region: GeodesicRegion, agents_m: NDArray[np.float64], cells: GeodesicCells
) -> NDArray[np.float64]:
    """Return where each agent should move: toward the middle of its cell, by a free straight line.

    The step is the mean over the cell of distance times leaving direction, which is ``C - p`` where
    nothing is in the way. It ends before an obstacle, or slides to the nearest free place, and is
    halved until it lowers the agent's own share of H. Moving all agents to their targets therefore
    never raises H.
    """
    count = len(agents_m)
    mass = np.where(cells.mass > 0.0, cells.mass, 1.0)
    step = -0.5 * cells.gradient / mass[:, None]
    before = np.bincount(cells.owner, region.mass * cells.distance_m**2, minlength=count)
    targets, waiting = agents_m.copy(), np.flatnonzero((step != 0.0).any(axis=1))
    for halving in range(HALVINGS):
        tried = agents_m.copy()
        tried[waiting] = _reached(region, agents_m[waiting], step[waiting] * 0.5**halving)
        share = _own_cost(region, tried, cells.owner, waiting)
        better = waiting[share[waiting] < before[waiting]]
        targets[better] = tried[better]
        waiting = np.setdiff1d(waiting, better)
        if not len(waiting):
            break
    return targets


def geodesic_distances_m(
    region: GeodesicRegion, agents_m: NDArray[np.float64], places_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the shortest distances of agents to places."""
    # Shapes: agents_m, places_m (n, 2).
    agents = _checked(region, agents_m)
    found = np.where(
        region.sees_each(agents, places_m),
        np.linalg.norm(agents[:, None] - places_m, axis=2),
        np.inf,
    )
    if len(region.corners_m):
        reach = _to_corners(region, agents).length_m
        last = np.linalg.norm(region.corners_m[:, None] - places_m, axis=2)
        last[~region.sees_each(region.corners_m, places_m)] = np.inf
        for length, to_place in zip(reach.T, last, strict=True):
            found = np.minimum(found, length[:, None] + to_place)
    return found


def geodesic_paths(
    region: GeodesicRegion, agents_m: NDArray[np.float64], places_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the length of the shortest path of each agent to a place of its own, and where to."""
    # Shapes: agents_m, places_m (n, 2); returns (n,).
    agents = _checked(region, agents_m)
    length, first = np.linalg.norm(places_m - agents, axis=1), places_m.copy()
    blind = np.flatnonzero(~region.sees(agents, places_m))
    if len(blind) and len(region.corners_m):
        corners = _to_corners(region, agents[blind])
        last = np.linalg.norm(places_m[blind][:, None] - region.corners_m, axis=2)
        last[~region.sees_each(places_m[blind], region.corners_m)] = np.inf
        through = corners.length_m + last
        best, own = through.argmin(axis=1), np.arange(len(blind))
        length[blind] = through[own, best]
        first[blind] = region.corners_m[corners.first[own, best]]
    return length, first


def _checked(region: GeodesicRegion, agents_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Agents as an array (n, 2) of free places."""
    agents = np.asarray(agents_m, dtype=np.float64)
    if agents.ndim != 2 or agents.shape[1] != 2 or not len(agents):
        raise InputError(f"places of shape {agents.shape} are given", key="agents")
    wrong = np.ones(len(agents), dtype=np.bool_)
    finite = np.asarray(np.isfinite(agents).all(axis=1))
    wrong[finite] = ~region.contains(agents[finite])
    if wrong.any():
        which = int(wrong.argmax())
        x, y = agents[which]
        raise InputError(f"({x:g}, {y:g}) is not in the free area", key=f"agents[{which}]")
    return agents


def _nearest(tree: KDTree, places: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Numbers (k, count) of the agents nearest to places (k, 2), nearest first."""
    found = tree.query(places, k=count)[1]  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    return np.asarray(found, dtype=np.intp).reshape(len(places), count)  # pyright: ignore[reportUnknownArgumentType]


def _to_corners(region: GeodesicRegion, agents: NDArray[np.float64]) -> _Corners:
    """Shortest ways from agents (n, 2) to all corners."""
    corners, count = region.corners_m, len(agents)
    if not len(corners):
        return _Corners(np.zeros((count, 0)), np.zeros((count, 0), dtype=np.intp))
    away = np.linalg.norm(agents[:, None] - corners, axis=2)
    away[~region.sees_each(agents, corners)] = np.inf
    length, first = np.empty(away.shape), np.empty(away.shape, dtype=np.intp)
    extent = float(np.ptp(region.nodes_m, axis=0).max())
    for agent in range(count):
        through = away[agent, :, None] + region.between_m
        length[agent] = through.min(axis=0)
        # A way that begins with the corner the agent stands on leaves toward the next one.
        at = away[agent] <= AT_CORNER * extent
        if at.any() and not at.all():
            through[at] += AT_CORNER * extent
        first[agent] = through.argmin(axis=0)
    return _Corners(length, first)


def _own_cost(
    region: GeodesicRegion,
    agents: NDArray[np.float64],
    owner: NDArray[np.intp],
    wanted: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Return the cost of each cell from its agent's place; (n,), 0 for agents not wanted."""
    asked = np.zeros(len(agents), dtype=np.bool_)
    asked[wanted] = True
    nodes = np.flatnonzero(asked[owner])
    own = owner[nodes]
    distance = np.linalg.norm(region.nodes_m[nodes] - agents[own], axis=1)
    blind = ~region.sees(agents[own], region.nodes_m[nodes])
    if blind.any():
        ways = _to_corners(region, agents[wanted]).length_m
        row = np.zeros(len(agents), dtype=np.intp)
        row[wanted] = np.arange(len(wanted))
        hidden = nodes[blind]
        through = ways[row[own[blind]]] + np.linalg.norm(
            region.nodes_m[hidden][:, None] - region.corners_m, axis=2
        )
        through[~region.corner_sees[hidden]] = np.inf
        distance[blind] = through.min(axis=1)
    return np.asarray(
        np.bincount(own, region.mass[nodes] * distance**2, minlength=len(agents)), dtype=np.float64
    )


def _reached(
    region: GeodesicRegion, starts: NDArray[np.float64], steps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where steps (k, 2) from places (k, 2) lead within what is allowed to agents.

    That is the end of the step if it is in sight, else the nearest allowed place to it if that is
    in sight, else the last allowed place on the line.
    """
    ends = starts + steps
    fine = region.allows(starts, ends)
    for which in np.flatnonzero(~fine):
        start, end = starts[which], ends[which]
        nearest = nearest_place(region.allowed, end)
        if region.allows(start[None], nearest[None])[0]:
            ends[which] = nearest
            continue
        line = shapely.LineString([start, end])
        touching = shapely.get_parts(line.intersection(region.allowed))
        touching = touching[shapely.dwithin(touching, shapely.Point(start), 0.0)]
        places = np.concatenate((start[None], shapely.get_coordinates(touching)))
        ends[which] = places[int(np.linalg.norm(places - start, axis=1).argmax())]
    return ends
