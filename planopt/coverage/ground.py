"""Convex ground: coverage cost of a region without obstacles from exact Voronoi cells."""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import KDTree

from planopt.arrays import Floats, Indices, Mask
from planopt.coverage.density import UNIFORM, Density
from planopt.coverage.network import Network
from planopt.coverage.voronoi import (
    Cells,
    ConvexRegion,
    agent_neighbours,
    cell_boundary,
    merge_coincident,
    region_boundary,
    voronoi_cells,
)
from planopt.world.shortest_paths import nearest_places

SAMPLES = 100  # Number of sample points along each side of the bounding box
EMPTY = 1e-12
"""Share of the mass below which a cell counts as empty, since its centroid is inaccurate."""


TOUCHING = 1e-7
"""Distance, as a share of the region's radius, below which agents have the same neighbours."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Coverage cost of a ground and targets of the agents."""

    cost: float  # The coverage cost H
    # (n, 2) centroid of each agent's cell, or its own position if the cell has no mass; with
    # obstacles the end of a collision-free step toward the centre of the cell
    targets_m: Floats
    mass: Floats  # (n,) mass of each agent's cell


def coverage(
    cells: Cells, density: Density = UNIFORM, sensing_range_m: float | None = None
) -> Cover:
    """Evaluate the coverage cost and the centroids of all cells.

    Results are exact up to rounding for the uniform density and for rasters. Other densities are
    integrated by Gauss quadrature.
    """
    moments = density.moments(cell_boundary(cells, sensing_range_m))
    cost = float(moments.second.sum())
    if sensing_range_m is not None:
        mass = float(density.moments(region_boundary(cells.region)).mass[0])
        cost += sensing_range_m**2 * max(mass - float(moments.mass.sum()), 0.0)
    empty = ~(moments.mass > EMPTY * moments.mass.sum())
    offset = moments.first / np.where(empty, 1.0, moments.mass)[:, None]
    offset[empty] = 0.0
    which = cells.cell_of
    return Cover(cost, (cells.generators_m + offset)[which], moments.mass[which])


@dataclass(frozen=True, eq=False)
class TwoNearest:
    """Sample points of a ground with their squared distances to the two nearest agents."""

    samples_m: Floats  # (m, 2)
    mass: Floats  # (m,)
    owner: Indices  # (m,) index of the nearest agent
    first_m2: Floats  # (m,) at most the square of the sensing range
    second_m2: Floats


@dataclass(frozen=True, eq=False)
class ConvexGround:
    """Convex region without obstacles."""

    hull: ConvexRegion  # The region, which is its own convex hull
    density: Density = UNIFORM
    sensing_range_m: float | None = None  # None without limit

    @property
    def free(self) -> shapely.Polygon:
        """Return the region without obstacles as a polygon."""
        return shapely.Polygon(self.hull.corners_m)

    @property
    def area_m2(self) -> float:
        """Return the covered area in square metres."""
        return self.hull.area_m2

    def allows(self, places_m: Floats) -> Mask:
        """Return a mask (k,) of the positions (k, 2) that are allowed for agents."""
        return self.hull.contains(places_m)

    def nearest(self, places_m: Floats) -> Floats:
        """Project positions ``(k, 2)`` onto the region."""
        moved, out = np.array(places_m, dtype=np.float64), ~self.hull.contains(places_m)
        moved[out] = nearest_places(self.free, moved[out])
        return moved

    def cover(self, agents_m: Floats) -> Cover:
        """Return the coverage cost and the targets of agents ``(n, 2)``."""
        return coverage(voronoi_cells(self.hull, agents_m), self.density, self.sensing_range_m)

    def two_nearest(self, agents_m: Floats) -> TwoNearest:
        """Return sample points on a grid, with squared distances to the two nearest agents."""
        low, high = self.hull.corners_m.min(axis=0), self.hull.corners_m.max(axis=0)
        along = (np.arange(SAMPLES) + 0.5) / SAMPLES
        grid = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        samples = low + grid * (high - low)
        samples = samples[self.hull.contains(samples)]
        found = KDTree(agents_m).query(samples, k=2)
        distances, agents = np.asarray(found[0], dtype=np.float64), np.asarray(found[1])
        reach = math.inf if self.sensing_range_m is None else self.sensing_range_m
        first, second = (np.minimum(distances, reach) ** 2).T
        share_m2 = float((high - low).prod()) / SAMPLES**2
        return TwoNearest(samples, share_m2 * self.density.at(samples), agents[:, 0], first, second)

    def borders(self, agents_m: Floats) -> Floats:
        """Return the cell boundaries as line segments (e, 2, 2) for figures."""
        cells = voronoi_cells(self.hull, agents_m).inside
        return np.stack((cells.corners_m, cells.corners_m[cells.following]), axis=1)

    def distances_m(self, agents_m: Floats, places_m: Floats) -> Floats:
        """Return the lengths (n, k) of shortest paths from agents to positions."""
        return np.linalg.norm(agents_m[:, None] - places_m, axis=2)

    def steered(self, agents_m: Floats, places_m: Floats, share: float) -> Floats:
        """Return targets (n, 2): `places_m` themselves, as shortest paths are straight."""
        # The result does not depend on `share`; it does on grounds with obstacles.
        return places_m


def neighbour_network(hull: ConvexRegion, agents_m: Floats) -> Network:
    """Return the Voronoi neighbour graph, which is connected, of agents in a convex region."""
    # Merge nearly coincident agents, whose bisectors would be rounding error.
    places, group = merge_coincident(agents_m, TOUCHING * hull.radius_m)
    cells = voronoi_cells(hull, places[group])
    return Network(len(agents_m), agent_neighbours(cells))
