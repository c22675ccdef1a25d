"""Voronoi cells of thousands of agents in a convex region.

Four extra points far outside bound every cell; their bisectors do not reach the region.
"""

import itertools
from dataclasses import dataclass
from typing import cast

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from planopt.arrays import Floats, Indices, Mask
from planopt.errors import InputError

ON_BORDER = 1e-9  # Tolerance of the boundary as a share of the region's radius
FLAT = 1e-12  # Sine of the turning angle up to which a vertex counts as collinear


@dataclass(frozen=True, eq=False)
class ConvexRegion:
    """Bounded convex polygon without obstacles; :func:`convex_region` builds it."""

    # (k, 2) corners in counter-clockwise order, not closed, without collinear corners
    corners_m: Floats
    normals: Floats  # (k, 2) outward unit normals of the sides that start at those corners
    offsets_m: Floats  # (k,): the region is {q : normals @ q <= offsets_m}
    centre_m: Floats  # (2,) centre of the bounding box
    radius_m: float  # Largest distance of a corner from the centre
    area_m2: float  # Area in square metres

    def excess_m(self, places_m: Floats) -> Floats:
        """Return the largest distance (n,) of positions (n, 2) beyond a side; negative inside."""
        return (places_m @ self.normals.T - self.offsets_m).max(axis=1)

    def contains(self, places_m: Floats) -> Mask:
        """Return a mask (n,) of the positions (n, 2) inside the region or on its boundary."""
        return self.excess_m(places_m) <= ON_BORDER * self.radius_m


def convex_region(polygon: shapely.Polygon | Floats) -> ConvexRegion:
    """Validate a convex polygon and return it as a region."""
    checked = checked_polygon(polygon)
    hull = checked.convex_hull
    missing_m2 = hull.area - checked.area
    if checked.interiors or missing_m2 > ON_BORDER * hull.area:
        raise InputError(
            "is not convex" if not checked.interiors else "has holes",
            key="world.outline_m",
            remedy="use geodesic cells for such a region",
        )
    corners = _corners(np.asarray(shapely.get_coordinates(hull), dtype=np.float64)[:-1])
    side = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(side[:, 0], side[:, 1])
    normals = np.stack((side[:, 1], -side[:, 0]), axis=1) / length[:, None]
    offsets = np.einsum("ij,ij->i", normals, corners)
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    radius = float(np.hypot(*(corners - centre).T).max())
    return ConvexRegion(corners, normals, offsets, centre, radius, float(hull.area))


def checked_polygon(polygon: shapely.Polygon | Floats) -> shapely.Polygon:
    """Return a valid polygon of positive area; raise `InputError` otherwise."""
    whole = isinstance(polygon, shapely.Polygon)
    coordinates = np.asarray(
        shapely.get_coordinates(polygon) if whole else polygon, dtype=np.float64
    )
    if coordinates.ndim != 2 or coordinates.shape[1] != 2 or len(coordinates) < 3:
        raise InputError(
            f"has shape {coordinates.shape}, which is not a polygon",
            key="world.outline_m",
            remedy="give at least three corners [x, y] in metres",
        )
    if not np.isfinite(coordinates).all():
        raise InputError("has a corner that is NaN or infinite", key="world.outline_m")
    candidate = polygon if whole else shapely.Polygon(coordinates)
    if not shapely.is_valid(candidate):
        raise InputError(
            f"is invalid: {shapely.is_valid_reason(candidate)}",
            key="world.outline_m",
            remedy="list the corners in order along the outline",
        )
    extent = float(np.ptp(coordinates, axis=0).max())
    if not candidate.area > ON_BORDER * extent**2:
        raise InputError("has no area", key="world.outline_m")
    return candidate


def _corners(ring: Floats) -> Floats:
    """Drop collinear vertices of a convex ring ``(k, 2)`` and order it counter-clockwise."""
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    if turn.sum() < 0.0:
        return _corners(ring[::-1])
    return ring[turn > FLAT * np.hypot(*before.T) * np.hypot(*after.T)]


COINCIDENT = 1e-12  # Distance, as a share of the region's radius, below which agents share one cell
FAR = 4.0
"""Distance of the four extra points in radii of the region; bisectors stay outside from 3 on."""


@dataclass(frozen=True, eq=False)
class Polygons:
    """Convex polygons stored in flat arrays."""

    # (v, 2) corners of all polygons in sequence, each polygon in counter-clockwise order
    corners_m: Floats
    first: Indices  # (g + 1,): polygon i has the corners first[i] : first[i + 1]

    @property
    def polygon_of(self) -> Indices:
        """Return the polygon index (v,) of each corner."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))

    @property
    def following(self) -> Indices:
        """Return the index (v,) of each corner's successor in its polygon, cyclically."""
        after = np.arange(1, len(self.corners_m) + 1)
        begun = np.diff(self.first) > 0
        after[self.first[1:][begun] - 1] = self.first[:-1][begun]
        return after


@dataclass(frozen=True, eq=False)
class Cells:
    """Voronoi partition of a region."""

    # Agents at the same position share one cell: ``n`` agents have ``g <= n`` cells.

    region: ConvexRegion  # Partitioned region
    generators_m: Floats  # (g, 2) distinct agent positions
    cell_of: Indices  # (n,) index of each agent's cell
    multiplicity: Indices  # (g,) number of agents that share the cell
    inside: Polygons  # Cells clipped to the region
    # Unclipped cells in coordinates that centre the region and give it radius 1
    unclipped: Polygons


def voronoi_cells(region: ConvexRegion, agents_m: Floats) -> Cells:
    """Compute the Voronoi partition of a region for agents ``(n, 2)``."""
    # The computing time grows as n log n.
    outside = np.flatnonzero(~region.contains(agents_m))
    if len(outside):
        x, y = agents_m[outside[0]]
        raise InputError(f"is at ({x:g}, {y:g}) m, outside the region", key=f"agents[{outside[0]}]")
    generators, cell_of = merge_coincident(agents_m, COINCIDENT * region.radius_m)
    # Shift and scale, since large coordinates would cost precision.
    scaled, count = (generators - region.centre_m) / region.radius_m, len(generators)
    far = FAR * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    sites = shapely.multipoints(np.concatenate((scaled, far)))
    diagram = shapely.get_parts(shapely.voronoi_polygons(sites, ordered=True))[:count]
    # GEOS returns clockwise rings and repeats the first corner at the end.
    closed, cell = shapely.get_coordinates(diagram[::-1], return_index=True)
    kept = np.append(cell[1:] == cell[:-1], False)
    sizes = np.bincount(cell[kept], minlength=count)[::-1]
    unclipped = Polygons(closed[kept][::-1], np.concatenate(([0], np.cumsum(sizes))))
    offsets = (region.offsets_m - region.normals @ region.centre_m) / region.radius_m
    clipped = _clipped(unclipped, region.normals, offsets)
    return Cells(
        region,
        generators,
        cell_of,
        np.bincount(cell_of, minlength=count),
        Polygons(region.centre_m + region.radius_m * clipped.corners_m, clipped.first),
        unclipped,
    )


def adjacent_cells(cells: Cells) -> Indices:
    """Return index pairs ``(e, 2)`` of cells with a common edge in the region, smaller first."""
    diagram = cells.unclipped
    start, stop = diagram.corners_m, diagram.corners_m[diagram.following]
    # Both cells of an edge have the same two corners, so its midpoint is identical to the bit.
    middle = start + stop
    order = np.lexsort((middle[:, 1], middle[:, 0]))
    same = (middle[order[1:]] == middle[order[:-1]]).all(axis=1)
    one, other = order[:-1][same], order[1:][same]
    owner = diagram.polygon_of
    pair = np.sort(np.stack((owner[one], owner[other]), axis=1), axis=1)
    region = cells.region
    scaled = shapely.Polygon((region.corners_m - region.centre_m) / region.radius_m)
    shapely.prepare(scaled)
    edges = shapely.linestrings(np.stack((start[one], stop[one]), axis=1))
    return pair[shapely.intersects(scaled, edges)]


def agent_neighbours(cells: Cells) -> Indices:
    """Return index pairs ``(e, 2)`` of agents that are Voronoi neighbours, smaller first."""
    # Coincident agents are neighbours of each other and share all other neighbours.
    adjacent = adjacent_cells(cells)
    count = len(cells.generators_m)
    if count == len(cells.cell_of):
        # Each cell has one agent.
        agent = np.argsort(cells.cell_of)
        return np.sort(agent[adjacent], axis=1)
    order = np.argsort(cells.cell_of, kind="stable")
    begin = np.concatenate(([0], np.cumsum(cells.multiplicity)))
    members: list[list[int]] = [order[begin[i] : begin[i + 1]].tolist() for i in range(count)]
    touching: list[tuple[int, int]] = adjacent.tolist()
    linked = [(a, b) for i, j in touching for a in members[i] for b in members[j]]
    linked += [pair for group in members for pair in itertools.combinations(group, 2)]
    return np.sort(np.array(linked, dtype=np.intp).reshape(-1, 2), axis=1)


def merge_coincident(places_m: Floats, within_m: float) -> tuple[Floats, Indices]:
    """Merge points linked by gaps up to `within_m`; return them and each point's new index (n,)."""
    # Shapes: places_m (n, d); returns (g, d) and (n,).
    tree = KDTree(places_m)
    pairs, count = tree.query_pairs(within_m, output_type="ndarray"), len(places_m)
    if not len(pairs):
        return places_m, np.arange(count)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    label = cast("NDArray[np.int32]", connected_components(graph, directed=False)[1])
    _, first, group = np.unique(label, return_index=True, return_inverse=True)
    return places_m[first], group


def _clipped(polygons: Polygons, normals: Floats, offsets: Floats) -> Polygons:
    """Return all polygons, each clipped to its half-planes ``normals @ q <= offsets``."""
    # Every polygon keeps its number, even if it becomes empty.
    for normal, offset in zip(normals, offsets, strict=True):
        corners = polygons.corners_m
        beyond = corners @ normal - offset
        out = beyond > 0.0
        if not out.any():
            continue
        after = polygons.following
        crossing = out != out[after]
        share = beyond[crossing] / (beyond[crossing] - beyond[after[crossing]])
        cut = corners[crossing] + share[:, None] * (corners[after[crossing]] - corners[crossing])
        # Corners inside are kept; an edge that crosses the side adds a corner after its first one.
        ends = np.cumsum(np.where(out, 0, 1) + crossing)
        clipped = np.empty((ends[-1], 2))
        clipped[ends[crossing] - 1] = cut
        clipped[(ends - crossing)[~out] - 1] = corners[~out]
        polygons = Polygons(clipped, np.concatenate(([0], ends))[polygons.first])
    return polygons


@dataclass(frozen=True, eq=False)
class Boundary:
    """Closed boundaries of cells in counter-clockwise order, relative to the cell centres."""

    # Cells are star-shaped: they contain the straight line from the centre to each of their points.

    centres_m: Floats  # (g, 2) agent position of each cell
    cell: Indices  # (e,) index of each piece's cell
    start_m: Floats  # (e, 2) both ends of each piece, relative to the cell's centre
    end_m: Floats
    # (e,) angle in rad between both ends of an arc about the centre; 0 if straight
    angle: Floats


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of a density over cells about the cell centres."""

    mass: Floats  # (g,) integral of the density
    first: Floats  # (g, 2) integral of the density times the offset from the centre
    second: Floats  # (g,) integral of the density times the squared distance from the centre


def cell_boundary(cells: Cells, sensing_range_m: float | None = None) -> Boundary:
    """Return the boundaries of all cells, limited to the sensing range if it is not None."""
    cell = cells.inside.polygon_of
    start = cells.inside.corners_m - cells.generators_m[cell]
    end = start[cells.inside.following]
    if sensing_range_m is None:
        return Boundary(cells.generators_m, cell, start, end, np.zeros(len(cell)))
    return _within_range(cells.generators_m, cell, start, end, sensing_range_m)


def region_boundary(region: ConvexRegion) -> Boundary:
    """Return the boundary of the whole region as one cell about the region's centre."""
    middle = region.corners_m.mean(axis=0)
    start = region.corners_m - middle
    sides = len(start)
    none = np.zeros(sides)
    return Boundary(
        middle[None], np.zeros(sides, dtype=np.intp), start, np.roll(start, -1, axis=0), none
    )


def _within_range(
    centres_m: Floats, cell: Indices, start: Floats, end: Floats, range_m: float
) -> Boundary:
    """Return boundaries clipped to the sensing range; parts beyond it become arcs."""
    along = end - start
    square = (along * along).sum(axis=1)
    middle = (start * along).sum(axis=1)
    past = (start * start).sum(axis=1) - range_m**2
    root2 = middle * middle - square * past
    meets = (root2 > 0.0) & (square > 0.0)
    root = np.sqrt(np.where(meets, root2, 0.0))
    divisor = np.where(square > 0.0, square, 1.0)
    # Parameters of the edge at which it enters and leaves the range.
    enter = np.clip((-middle - root) / divisor, 0.0, 1.0)
    leave = np.clip((-middle + root) / divisor, 0.0, 1.0)
    inner = meets & (leave > enter)
    first, last = start + enter[:, None] * along, start + leave[:, None] * along
    # An edge entirely beyond the range becomes one arc.
    before, after = (enter > 0.0) | ~inner, inner & (leave < 1.0)
    tail = np.where(inner[:, None], first, end)
    arcs = [_arc(start[before], tail[before], range_m), _arc(last[after], end[after], range_m)]
    return Boundary(
        centres_m,
        np.concatenate((cell[inner], cell[before], cell[after])),
        np.concatenate((first[inner], arcs[0][0], arcs[1][0])),
        np.concatenate((last[inner], arcs[0][1], arcs[1][1])),
        np.concatenate((np.zeros(int(inner.sum())), arcs[0][2], arcs[1][2])),
    )


def _arc(start: Floats, end: Floats, range_m: float) -> tuple[Floats, Floats, Floats]:
    """Project the ends of boundary pieces onto the range circle; return new ends and angles."""
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    angle = np.arctan2(cross, (start * end).sum(axis=1))
    length = np.hypot(start[:, 0], start[:, 1]), np.hypot(end[:, 0], end[:, 1])
    return start * (range_m / length[0])[:, None], end * (range_m / length[1])[:, None], angle
