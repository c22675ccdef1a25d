"""Regions that are not convex or hold obstacles, and shortest distances in them.

Shortest paths turn only at corners that stand out into the free area. The distances between those
corners, and which of them each node of a grid sees, are found once; then the distance of any agent
to any node is exact and costs a few sums.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.boundary import Boundary
from planopt.coverage.cost import UNIFORM
from planopt.coverage.density import Density, UniformDensity
from planopt.coverage.region import checked_polygon, positive
from planopt.errors import InputError

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
    corners = _outstanding(free)
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


def _outstanding(free: shapely.Polygon) -> NDArray[np.float64]:
    """Corners (c, 2) of the free area with more than half a turn of it around them."""
    found = [np.zeros((0, 2))]
    # Rings are oriented so that the free area is on their left.
    for ring in (free.exterior, *free.interiors):
        places = np.asarray(shapely.get_coordinates(ring), dtype=np.float64)[:-1]
        before, after = places - np.roll(places, 1, axis=0), np.roll(places, -1, axis=0) - places
        found.append(places[before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] < 0.0])
    return np.unique(np.concatenate(found), axis=0)


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
