"""Convex grounds: the coverage cost of a free region by exact Voronoi cells.

A ground is what a network covers, with its distances; :mod:`planopt.coverage.geodesic` has the one
with obstacles and the union of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.coverage.density import UNIFORM, Density
from planopt.coverage.network import Network
from planopt.coverage.voronoi import (
    Cells,
    ConvexRegion,
    agent_neighbours,
    cell_boundary,
    merge_coincident,
    nearest_places,
    region_boundary,
    voronoi_cells,
)

Floats = NDArray[np.float64]

EMPTY = 1e-12
"""A cell with less than this share of the mass is empty: its centroid would be rounding error."""


TOUCHING = 1e-7
"""Agents nearer than this share of the region's radius have the same neighbours."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """The coverage cost of a region, its derivative, and the centroids of the cells."""

    cost: float  # The coverage cost H, in m^4 for the uniform density of 1 per m^2
    mass: Floats  # (n,) mass of each agent's cell
    # (n, 2) centroid of each agent's cell; the agent's own position if the cell has no mass
    centroids_m: Floats
    # (n, 2) derivative of H by each agent's position, 2 M (p - C). Agents at one position share
    # its derivative in equal parts.
    gradient: Floats


def coverage(
    cells: Cells, density: Density = UNIFORM, sensing_range_m: float | None = None
) -> Coverage:
    """Evaluate the coverage cost, its gradient and the centroids of all cells.

    Exact to rounding for the uniform density and for rasters; other densities are integrated by
    Gauss quadrature.
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
    share = -2.0 * moments.first / cells.multiplicity[:, None]
    centroids = cells.generators_m + offset
    return Coverage(cost, moments.mass[which], centroids[which], share[which])


@dataclass(frozen=True, eq=False)
class Cover:
    """The coverage cost of a ground, and the targets of the agents."""

    cost: float  # The coverage cost H
    # (n, 2): the centroid of each agent's cell, or with obstacles the end of a free step toward the
    # middle of it
    targets_m: Floats


@dataclass(frozen=True, eq=False)
class ConvexGround:
    """A convex region without obstacles."""

    region: ConvexRegion
    density: Density = UNIFORM
    sensing_range_m: float | None = None  # None without limit

    @property
    def free(self) -> shapely.Polygon:
        """Return the region without obstacles as a polygon."""
        return shapely.Polygon(self.region.corners_m)

    @property
    def hull(self) -> ConvexRegion:
        """Return the convex region around; events and neighbours are searched there."""
        return self.region

    @property
    def area_m2(self) -> float:
        """Return the covered area."""
        return self.region.area_m2

    def allows(self, places_m: Floats) -> NDArray[np.bool_]:
        """Return whether agents may be at positions ``(k, 2)``; (k,)."""
        return self.region.contains(places_m)

    def nearest(self, places_m: Floats) -> Floats:
        """Return positions ``(k, 2)``, those outside moved to the nearest position of an agent."""
        moved, out = np.array(places_m, dtype=np.float64), ~self.region.contains(places_m)
        moved[out] = nearest_places(self.free, moved[out])
        return moved

    def cover(self, agents_m: Floats) -> Cover:
        """Return the cost and the targets of agents ``(n, 2)``."""
        found = coverage(voronoi_cells(self.region, agents_m), self.density, self.sensing_range_m)
        return Cover(found.cost, found.centroids_m)

    def borders(self, agents_m: Floats) -> Floats:
        """Return the borders of the agents' cells as segments ``(e, 2, 2)``, for pictures."""
        cells = voronoi_cells(self.region, agents_m).inside
        return np.stack((cells.corners_m, cells.corners_m[cells.following]), axis=1)

    def distances_m(self, agents_m: Floats, places_m: Floats) -> Floats:
        """Return the lengths ``(n, k)`` of shortest paths from agents to positions."""
        return np.linalg.norm(agents_m[:, None] - places_m, axis=2)

    def steered(self, agents_m: Floats, places_m: Floats, share: float) -> Floats:
        """Return a target ``(n, 2)`` of each agent on its path to a position of its own ``(n, 2)``.

        It lies in the direction of the shortest path, as far away as that is long, but so near
        that a move over the given share of the distance stays on the path's first straight part.
        """
        return places_m


def neighbour_network(hull: ConvexRegion, agents_m: Floats) -> Network:
    """Return the links of agents: Voronoi neighbours in a convex region, always connected."""
    # Agents that nearly touch count as being at one position: bisectors between them are rounding.
    places, group = merge_coincident(agents_m, TOUCHING * hull.radius_m)
    cells = voronoi_cells(hull, places[group])
    return Network(len(agents_m), agent_neighbours(cells))
