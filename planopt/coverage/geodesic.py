"""Coverage of non-convex regions or regions with obstacles, by shortest-path distances.

The visibility of corners from each grid node is computed once; distances and cost are then exact.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planopt.arrays import Floats, Indices, Mask
from planopt.coverage.density import UNIFORM, Density, UniformDensity
from planopt.coverage.ground import ConvexGround, Cover, TwoNearest
from planopt.coverage.voronoi import Boundary, ConvexRegion, checked_polygon, convex_region
from planopt.errors import InputError
from planopt.world.clearance import polygons_of
from planopt.world.shortest_paths import FreeArea, free_area, nearest_places

SLIVER = 1e-6  # Minimum area of a free part of a grid square, as a share of the square
LINE = 1  # Type number of line strings in Shapely
MAX_NODES = 200_000  # Largest number of nodes; visibility from more nodes takes minutes
HALVINGS = 8
"""Maximum number of halvings of a step until it lowers the cost of the agent's own cell."""
NEAREST = 8
"""Number of agents, nearest in a straight line, that are candidates for the second nearest."""
AT_CENTRE = 1e-9
"""Distance to the centre of a cell, as a share of the region's radius, that counts as arrived."""
AT_CORNER = 1e-9
"""Distance to a corner, as a share of the region's extent, that counts as being at it."""


@dataclass(frozen=True, eq=False)
class GeodesicGround:
    """Free area discretised by nodes; :func:`geodesic_ground` builds it."""

    free: shapely.Polygon  # Outline without the obstacles: the covered area
    area: FreeArea  # Part of `free` that keeps the clearance: allowed agent positions
    hull: ConvexRegion  # Convex hull of the free area
    spacing_m: float  # Side of the grid squares
    # (m, 2) nodes of free pieces of grid squares; `ends_m` are the nearest allowed positions
    nodes_m: Floats
    ends_m: Floats
    mass: Floats  # (m,) mass of each node's part
    spread: float  # Coverage cost if every node had its own agent
    corner_sees: Mask  # (m, c) whether the line from the node's end to a corner is free
    room_m: Floats  # (m,) distance of the node's end from the border; shorter lines are free

    @property
    def area_m2(self) -> float:
        """Area of `free` in square metres."""
        return float(self.free.area)

    def allows(self, places_m: Floats) -> Mask:
        """Return a mask (k,) of the positions (k, 2) that keep the clearance."""
        return self.area.allows(places_m)

    def nearest(self, places_m: Floats) -> Floats:
        """Project positions ``(k, 2)`` onto the allowed area."""
        return self.area.nearest(places_m)

    def cover(self, agents_m: Floats) -> Cover:
        """Return the coverage cost over the nodes, and targets that lower this cost."""
        # Near a corner an agent may keep the clearance and still be outside the mitred polygon.
        agents = self.nearest(agents_m)
        cells = geodesic_cells(self, agents)
        return Cover(cells.cost, geodesic_targets(self, agents, cells), cells.mass)

    def two_nearest(self, agents_m: Floats) -> TwoNearest:
        """Return nodes with squared distances to the two nearest agents, the second approximate."""
        agents = self.nearest(agents_m)
        cells = geodesic_cells(self, agents)
        area, nodes, owner = self.area, self.ends_m, cells.owner
        second = np.full(len(nodes), np.inf)
        if len(area.corners_m):
            reach, _ = area.to_corners_m(agents)
            one, other = np.argsort(reach, axis=0)[:2]
            away = np.asarray(np.where(one == owner[:, None], other, one), dtype=np.intp)
            legs = area.last_legs_m(nodes, self.corner_sees)
            second = (reach[away, np.arange(len(area.corners_m))] + legs).min(axis=1)
        for agent in _nearest(KDTree(agents), nodes, min(len(agents), NEAREST)).T:
            straight = np.linalg.norm(nodes - agents[agent], axis=1)
            seen = np.flatnonzero((agent != owner) & (straight < second))
            seen = seen[area.sees(agents[agent[seen]], nodes[seen])]
            second[seen] = straight[seen]
        second[np.isinf(second)] = float(np.ptp(nodes, axis=0).sum())
        return TwoNearest(nodes, self.mass, owner, cells.distance_m**2, second**2)

    def borders(self, agents_m: Floats) -> Floats:
        """Return cell boundaries (e, 2, 2), at equal distances from two agents, for figures."""
        agents = self.nearest(agents_m)
        cells, low = geodesic_cells(self, agents), np.asarray(self.free.bounds[:2])
        at = np.floor((self.nodes_m - low) / self.spacing_m).astype(np.intp) + 1
        image = np.full(at.max(axis=0) + 2, -1)
        image[at[:, 0], at[:, 1]] = np.arange(len(at))
        # Blocks of four nodes, anticlockwise; nodes that do not exist are -1.
        rings = (image[:-1, :-1], image[1:, :-1], image[1:, 1:], image[:-1, 1:])
        block = np.stack(rings, axis=-1).reshape(-1, 4)
        ends = np.stack((block, np.roll(block, -1, axis=1)), axis=-1)
        owner = np.where(ends >= 0, cells.owner[ends], -1)
        sides = (ends >= 0).all(axis=2) & (owner[..., 0] != owner[..., 1])
        crossed = np.full((*block.shape, 2), np.nan)
        node, mine = ends[sides], owner[sides]
        away = _path_lengths_m(self, agents, mine[:, ::-1].ravel(), node.ravel()).reshape(-1, 2)
        lead = np.maximum(away - cells.distance_m[node], 0.0)
        share = lead[:, :1] / np.maximum(lead.sum(axis=1, keepdims=True), 1e-12 * self.spacing_m)
        start, end = self.nodes_m[node[:, 0]], self.nodes_m[node[:, 1]]
        crossed[sides] = start + share * (end - start)
        some = np.flatnonzero(sides.any(axis=1))
        middle = np.nanmean(crossed[some], axis=1)
        # At the edge of the grid a boundary runs on at right angles to the line of both nodes.
        lone = some[sides[some].sum(axis=1) == 1]
        across = ends[lone][sides[lone]]
        step = self.nodes_m[across[:, 1]] - self.nodes_m[across[:, 0]]
        middle[np.isin(some, lone)] += np.stack((-step[:, 1], step[:, 0]), axis=1)
        which, side = np.nonzero(sides[some])
        lines = np.stack((crossed[some[which], side], middle[which]), axis=1)
        inside = shapely.get_parts(shapely.intersection(shapely.linestrings(lines), self.free))
        inside = inside[shapely.get_type_id(inside) == LINE]  # pyright: ignore[reportUnknownMemberType]
        return np.asarray(shapely.get_coordinates(inside), dtype=np.float64).reshape(-1, 2, 2)

    def distances_m(self, agents_m: Floats, places_m: Floats) -> Floats:
        """Return the lengths (n, k) of shortest paths from agents to positions."""
        return self.area.distances_m(self.nearest(agents_m), self.nearest(places_m))

    def steered(self, agents_m: Floats, places_m: Floats, share: float) -> Floats:
        """Return targets (n, 2); moves by `share` to them follow shortest paths to `places_m`."""
        starts = self.nearest(agents_m)
        turn, length = self.area.first_turns_m(starts, self.nearest(places_m))
        leg = turn - starts
        straight = np.linalg.norm(leg, axis=1)
        ahead = np.minimum(length, straight / share)
        return starts + leg * (ahead / np.where(straight > 0.0, straight, 1.0))[:, None]


Ground = ConvexGround | GeodesicGround
"""Region that a network covers; control and simulation use only the common methods."""


def geodesic_ground(
    outline: shapely.Polygon | Floats,
    obstacles: Sequence[shapely.Polygon],
    spacing_m: float,
    density: Density = UNIFORM,
    clearance_m: float = 0.0,
) -> GeodesicGround:
    """Return a region with obstacles, prepared for coverage by shortest-path distances."""
    free = _in_one_part(checked_polygon(outline), obstacles)
    kept = [free]
    if clearance_m > 0.0:
        kept = polygons_of(free.buffer(-clearance_m, join_style="mitre"))
    if len(kept) != 1:
        raise InputError(
            f"is {clearance_m:g} m, which leaves {len(kept)} separate parts of the region",
            key="world.clearance_m",
            remedy="give a smaller clearance, or a smaller agents.body_radius_m",
        )
    area = free_area(shapely.orient_polygons(kept[0]))
    hull = convex_region(np.asarray(shapely.get_coordinates(free.convex_hull)))
    nodes, mass, spread = _nodes(free, spacing_m, density)
    ends = area.nearest(nodes) if clearance_m > 0.0 else nodes
    sees = area.sees_each(ends, area.corners_m)
    room_m = _room_m(area, ends)
    return GeodesicGround(free, area, hull, spacing_m, nodes, ends, mass, spread, sees, room_m)


def _room_m(area: FreeArea, places_m: Floats) -> Floats:
    """Return the distances (k,) of positions from the border of an area."""
    away_m = shapely.distance(area.border, shapely.points(places_m))  # pyright: ignore[reportUnknownMemberType]
    return np.asarray(away_m, dtype=np.float64)


def _seen(
    ground: GeodesicGround, agents_m: Floats, room_m: Floats, nodes: Indices, straight_m: Floats
) -> Mask:
    """Return a mask (k,) of the nodes that agents see along lines of lengths `straight_m`."""
    # A line shorter than the distance of one end from the border does not meet the border.
    seen = straight_m < np.maximum(ground.room_m[nodes], room_m)
    rest = np.flatnonzero(~seen)
    seen[rest] = ground.area.sees(agents_m[rest], ground.ends_m[nodes[rest]])
    return seen


def _in_one_part(whole: shapely.Polygon, obstacles: Sequence[shapely.Polygon]) -> shapely.Polygon:
    """Return the region minus the obstacles; raise `InputError` if it is not connected."""
    left: shapely.Geometry = whole
    for number, obstacle in enumerate(obstacles):
        if not (shapely.is_valid(obstacle) and obstacle.area > 0.0):
            raise InputError("has a self-intersecting outline", key=f"world.obstacles[{number}]")
        left = left.difference(obstacle)
    parts = polygons_of(left)
    if not parts:
        raise InputError(
            "cover the whole region", key="world.obstacles", remedy="remove some of them"
        )
    if len(parts) > 1:
        areas = ", ".join(f"{part.area:.4g}" for part in parts)
        raise InputError(
            f"divide the region into {len(parts)} separate parts of {areas} m²",
            key="world.obstacles",
            remedy="make a problem for each part",
        )
    return shapely.orient_polygons(parts[0])


def _nodes(
    free: shapely.Polygon, spacing_m: float, density: Density
) -> tuple[Floats, Floats, float]:
    """Return nodes (m, 2), masses (m,), and the coverage cost with an agent at every node."""
    x_min, y_min, x_max, y_max = free.bounds
    columns = math.ceil((x_max - x_min) / spacing_m)
    rows = math.ceil((y_max - y_min) / spacing_m)
    if columns * rows > MAX_NODES:
        raise InputError(
            f"is {spacing_m:g} m, which makes {columns * rows} nodes",
            key="world.spacing_m",
            remedy=f"give a larger spacing: at most {MAX_NODES} nodes are allowed",
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
    moments = UniformDensity().moments(polygon_boundaries(pieces, nodes))
    mass = weight * moments.mass
    if not mass.sum() > 0.0:
        raise InputError("is 0 everywhere", key="density", remedy="give a positive value")
    return nodes, mass, float(weight @ moments.second)


def polygon_boundaries(pieces: NDArray[np.object_], nodes_m: Floats) -> Boundary:
    """Return the boundaries of polygons relative to `nodes_m` (m, 2); holes are clockwise."""
    rings, piece = shapely.get_rings(shapely.orient_polygons(pieces), return_index=True)
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    cell = piece[ring]
    same = ring[1:] == ring[:-1]
    spokes = corners - nodes_m[cell]
    none = np.zeros(int(same.sum()))
    return Boundary(nodes_m, cell[:-1][same], spokes[:-1][same], spokes[1:][same], none)


@dataclass(frozen=True, eq=False)
class GeodesicCells:
    """Geodesic Voronoi cells: the agent nearest to each node by the shortest path."""

    owner: Indices  # (m,) index of the nearest agent; of coincident agents, the smallest index
    distance_m: Floats  # (m,) length of the shortest path to the nearest agent
    cost: float  # The coverage cost H
    mass: Floats  # (n,) mass of each agent's cell
    gradient: Floats  # (n, 2) derivative of H with respect to each agent's position


def geodesic_cells(ground: GeodesicGround, agents_m: Floats) -> GeodesicCells:
    """Assign the nodes of a ground to agents ``(n, 2)``, and evaluate the coverage cost."""
    area, nodes, count = ground.area, ground.ends_m, len(agents_m)
    reach, first = area.to_corners_m(agents_m)
    distance = np.full(len(nodes), np.inf)
    owner = np.zeros(len(nodes), dtype=np.intp)
    turn = np.full(len(nodes), -1, dtype=np.intp)
    if len(area.corners_m):
        # Beyond a corner only the agent nearest to that corner matters.
        best = reach.argmin(axis=0)
        through = reach[best, np.arange(len(best))] + area.last_legs_m(nodes, ground.corner_sees)
        turn = through.argmin(axis=1)
        distance = through[np.arange(len(nodes)), turn]
        owner = best[turn]
    # Test straight lines, nearest agents first and ever more at once, while they may be shorter.
    tree, waiting, room_m = KDTree(agents_m), np.arange(len(nodes)), _room_m(area, agents_m)
    first_rank, ranks = 0, 1
    while first_rank < count and len(waiting):
        near = _nearest(tree, nodes[waiting], min(count, ranks))[:, first_rank:]
        straight = np.linalg.norm(nodes[waiting, None] - agents_m[near], axis=2)
        # A straight line is preferred to an equally long path over the agent's own corner.
        seen = straight <= distance[waiting, None] * (1.0 + AT_CORNER)
        more = seen[:, -1].copy()
        row, rank = np.nonzero(seen)
        agent = near[row, rank]
        seen[row, rank] = _seen(
            ground, agents_m[agent], room_m[agent], waiting[row], straight[row, rank]
        )
        some = np.flatnonzero(seen.any(axis=1))
        best, found = seen[some].argmax(axis=1), waiting[some]
        owner[found], distance[found], turn[found] = near[some, best], straight[some, best], -1
        more[some] = False
        waiting = waiting[more]
        first_rank, ranks = ranks, 2 * ranks
    toward = nodes - agents_m[owner]
    bent = turn >= 0
    toward[bent] = area.corners_m[first[owner[bent], turn[bent]]] - agents_m[owner[bent]]
    length = np.linalg.norm(toward, axis=1)
    direction = toward / np.where(length > 0.0, length, 1.0)[:, None]
    pull = 2.0 * ground.mass * distance
    gradient = np.zeros((count, 2))
    for axis in range(2):
        gradient[:, axis] -= np.bincount(owner, pull * direction[:, axis], minlength=count)
    cost = float(ground.mass @ distance**2) + ground.spread
    mass = np.asarray(np.bincount(owner, ground.mass, minlength=count), dtype=np.float64)
    return GeodesicCells(owner, distance, cost, mass, gradient)


def geodesic_targets(ground: GeodesicGround, agents_m: Floats, cells: GeodesicCells) -> Floats:
    """Return targets (n, 2) toward the cells' centres; moving to them never raises the cost."""
    # The step is the mean over the cell of path length times initial path direction; without
    # obstacles that is ``C - p``. It ends before an obstacle or slides to the nearest free
    # position. It is halved until it lowers the cost of the agent's own cell, so moving all agents
    # to their targets never raises H.
    count = len(agents_m)
    mass = np.where(cells.mass > 0.0, cells.mass, 1.0)
    step = -0.5 * cells.gradient / mass[:, None]
    before = np.bincount(cells.owner, ground.mass * cells.distance_m**2, minlength=count)
    moves = np.linalg.norm(step, axis=1) > AT_CENTRE * ground.hull.radius_m
    targets, waiting = agents_m.copy(), np.flatnonzero(moves)
    for halving in range(HALVINGS):
        trial = agents_m.copy()
        trial[waiting] = _reached(ground.area, agents_m[waiting], step[waiting] * 0.5**halving)
        nodes = np.flatnonzero(np.isin(cells.owner, waiting))
        own = cells.owner[nodes]
        distance = _path_lengths_m(ground, trial, own, nodes)
        after = np.bincount(own, ground.mass[nodes] * distance**2, minlength=count)
        better = waiting[after[waiting] < before[waiting]]
        targets[better] = trial[better]
        waiting = np.setdiff1d(waiting, better)
        if not len(waiting):
            break
    return targets


def _nearest(tree: KDTree, places: Floats, count: int) -> Indices:
    """Return the indices (k, count) of the agents nearest to positions (k, 2), nearest first."""
    found = tree.query(places, k=count)[1]
    return np.asarray(found, dtype=np.intp).reshape(len(places), count)


def _path_lengths_m(ground: GeodesicGround, agents: Floats, who: Indices, nodes: Indices) -> Floats:
    """Return the lengths (k,) of shortest paths from the agents `who` to the nodes `nodes`."""
    ends = ground.ends_m[nodes]
    distance = np.linalg.norm(ends - agents[who], axis=1)
    room_m = np.zeros(len(agents))
    chosen = np.unique(who)
    room_m[chosen] = _room_m(ground.area, agents[chosen])
    blind = np.flatnonzero(~_seen(ground, agents[who], room_m[who], nodes, distance))
    if len(blind):
        used, row = np.unique(who[blind], return_inverse=True)
        reach, _ = ground.area.to_corners_m(agents[used])
        last = ground.area.last_legs_m(ends[blind], ground.corner_sees[nodes[blind]])
        distance[blind] = (reach[row] + last).min(axis=1)
    return distance


def _reached(area: FreeArea, starts: Floats, steps: Floats) -> Floats:
    """Return end points of steps (k, 2), shortened or moved so that they stay allowed."""
    # A step ends at its full length if that position is allowed and visible, else at the nearest
    # allowed position if that is visible, else at the last allowed position on the line.
    ends = starts + steps
    for which in np.flatnonzero(~(area.allows(ends) & area.sees(starts, ends))):
        start, end = starts[which], ends[which]
        nearest = nearest_places(area.polygon, end[None])
        if area.allows(nearest)[0] and area.sees(start[None], nearest)[0]:
            ends[which] = nearest[0]
            continue
        line = shapely.LineString([start, end])
        touching = shapely.get_parts(line.intersection(area.polygon))
        touching = touching[shapely.dwithin(touching, shapely.Point(start), 0.0)]
        places = np.concatenate((start[None], shapely.get_coordinates(touching)))
        ends[which] = places[int(np.linalg.norm(places - start, axis=1).argmax())]
    return ends
