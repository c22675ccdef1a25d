"""Grounds: what a network covers, with its coverage cost, its distances and its neighbours.

A convex free region has exact cells; a region with obstacles has geodesic ones. Control and
simulation see neither, only the methods of :class:`Ground`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.coverage.density import UNIFORM, Density
from planopt.coverage.geodesic import (
    GeodesicRegion,
    geodesic_cells,
    geodesic_distances_m,
    geodesic_paths,
    geodesic_region,
    geodesic_targets,
    nearest_place,
)
from planopt.coverage.network import Network
from planopt.coverage.region import ConvexRegion, convex_region
from planopt.coverage.voronoi import (
    Cells,
    agent_neighbours,
    cell_boundary,
    merge_coincident,
    region_boundary,
    voronoi_cells,
)

EMPTY = 1e-12
"""A cell with less than this share of the mass is empty: its centroid would be rounding error."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """The coverage cost of a region, and the place where each agent should be."""

    cost: float  # The coverage cost H, in m^4 for the uniform density of 1 per m^2
    mass: NDArray[np.float64]  # (n,) mass of each agent's cell
    # (n, 2) centroid of each agent's cell; the agent's own place if the cell has no mass
    centroids_m: NDArray[np.float64]
    # (n, 2) derivative of H by each agent's place, 2 M (p - C). Agents at one place share the
    # derivative of the place in equal parts.
    gradient: NDArray[np.float64]


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


DRIVE_NODES = 16
"""Grid squares along the region that agents drive in, before it gets the covered region's nodes."""

TOUCHING = 1e-7
"""Agents nearer than this share of the region's radius have the same neighbours."""


@dataclass(frozen=True, eq=False)
class Cover:
    """The coverage cost of a ground, and where each agent should drive."""

    cost: float  # The coverage cost H
    # (n, 2): the centroid of each agent's cell, or with obstacles the end of a free step toward the
    # middle of it
    targets_m: NDArray[np.float64]


class Ground(Protocol):
    """The ground that a network covers: region, obstacles, density."""

    @property
    def free(self) -> shapely.Polygon:
        """Return the region without its obstacles."""
        ...

    @property
    def hull(self) -> ConvexRegion:
        """The convex region around it; events are looked for and neighbours found there."""
        ...

    @property
    def area_m2(self) -> float:
        """Area that is covered."""
        ...

    def allows(self, places_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether agents may be at places ``(k, 2)``; (k,)."""
        ...

    def nearest(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places ``(k, 2)``, each as it is or the nearest place that agents may be at."""
        ...

    def cover(self, agents_m: NDArray[np.float64]) -> Cover:
        """Return the cost and the targets of agents ``(n, 2)``."""
        ...

    def borders(self, agents_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the borders of the agents' cells as segments ``(e, 2, 2)``, for pictures."""
        ...

    def distances_m(
        self, agents_m: NDArray[np.float64], places_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the lengths ``(n, k)`` of shortest paths from agents to places."""
        ...

    def steered(
        self, agents_m: NDArray[np.float64], places_m: NDArray[np.float64], share: float
    ) -> NDArray[np.float64]:
        """Return a target ``(n, 2)`` for each agent on its way to a place of its own ``(n, 2)``.

        It lies in the direction of the shortest path, as far away as that is long, but so near
        that a move over the given share of the distance stays on the path's first straight part.
        """
        ...


@dataclass(frozen=True, eq=False)
class ConvexGround:
    """A convex region without obstacles."""

    region: ConvexRegion  # The region
    density: Density = UNIFORM  # Weight of each place
    sensing_range_m: float | None = None  # How far agents sense; None without limit

    @property
    def free(self) -> shapely.Polygon:
        """The region as a polygon."""
        return shapely.Polygon(self.region.corners_m)

    @property
    def hull(self) -> ConvexRegion:
        """The region itself."""
        return self.region

    @property
    def area_m2(self) -> float:
        """Its area."""
        return self.region.area_m2

    def allows(self, places_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether places are in the region or on its border."""
        return self.region.contains(places_m)

    def nearest(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places, those outside moved to the border."""
        moved = np.array(places_m, dtype=np.float64)
        for which in np.flatnonzero(~self.region.contains(moved)):
            moved[which] = nearest_place(shapely.Polygon(self.region.corners_m), moved[which])
        return moved

    def cover(self, agents_m: NDArray[np.float64]) -> Cover:
        """Return the exact cost and the centroids of the Voronoi cells."""
        found = coverage(voronoi_cells(self.region, agents_m), self.density, self.sensing_range_m)
        return Cover(found.cost, found.centroids_m)

    def borders(self, agents_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the edges of the Voronoi cells."""
        cells = voronoi_cells(self.region, agents_m).inside
        return np.stack((cells.corners_m, cells.corners_m[cells.following]), axis=1)

    def distances_m(
        self, agents_m: NDArray[np.float64], places_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return straight distances."""
        return np.linalg.norm(agents_m[:, None] - places_m, axis=2)

    def steered(
        self, agents_m: NDArray[np.float64], places_m: NDArray[np.float64], share: float
    ) -> NDArray[np.float64]:
        """Return the places: every straight line is free."""
        return places_m


@dataclass(frozen=True, eq=False)
class GeodesicGround:
    """A region with obstacles, or one that is not convex; :func:`geodesic_ground` builds it."""

    free: shapely.Polygon  # What is covered
    # Where agents may be. Its nodes stand for all that is covered; those within the clearance are
    # at the nearest place that agents may be.
    region: GeodesicRegion
    # (m, 2) where these nodes are themselves, and the side of their grid squares
    nodes_m: NDArray[np.float64]
    spacing_m: float
    hull: ConvexRegion  # The convex region around

    @property
    def area_m2(self) -> float:
        """Area of the free part."""
        return float(self.free.area)

    def allows(self, places_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether places are free and keep the clearance."""
        return self.region.contains(places_m)

    def nearest(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places, those that are not allowed moved to the nearest that are."""
        return self.region.nearest(places_m)

    def cover(self, agents_m: NDArray[np.float64]) -> Cover:
        """Return the cost over the region's nodes, and free steps that lower it."""
        # Beside a corner agents may keep the clearance and be outside of the straight-sided region.
        agents = self.region.nearest(agents_m)
        cells = geodesic_cells(self.region, agents)
        return Cover(cells.cost, geodesic_targets(self.region, agents, cells))

    def borders(self, agents_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sides of grid squares between nodes of different agents."""
        owner = geodesic_cells(self.region, self.region.nearest(agents_m)).owner
        low = np.asarray(self.free.bounds[:2])
        at = np.floor((self.nodes_m - low) / self.spacing_m).astype(np.intp)
        image = np.full(at.max(axis=0) + 1, -1)
        image[at[:, 0], at[:, 1]] = owner
        found = [np.zeros((0, 2, 2))]
        for axis in (0, 1):
            one, other = (image[:-1], image[1:]) if axis == 0 else (image[:, :-1], image[:, 1:])
            where = np.argwhere((one != other) & (one >= 0) & (other >= 0)).astype(np.float64)
            where[:, axis] += 1.0
            along = np.array([0.0, 1.0]) if axis == 0 else np.array([1.0, 0.0])
            found.append(low + self.spacing_m * np.stack((where, where + along), axis=1))
        return np.concatenate(found)

    def distances_m(
        self, agents_m: NDArray[np.float64], places_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return lengths of shortest paths to the places nearest to these that agents may be at."""
        agents, ends = self.region.nearest(agents_m), self.region.nearest(places_m)
        return geodesic_distances_m(self.region, agents, ends)

    def steered(
        self, agents_m: NDArray[np.float64], places_m: NDArray[np.float64], share: float
    ) -> NDArray[np.float64]:
        """Return targets along these shortest paths."""
        starts, ends = self.region.nearest(agents_m), self.region.nearest(places_m)
        length, first = geodesic_paths(self.region, starts, ends)
        leg = first - starts
        straight = np.linalg.norm(leg, axis=1)
        ahead = np.minimum(length, straight / share)
        return starts + leg * (ahead / np.where(straight > 0.0, straight, 1.0))[:, None]


def geodesic_ground(
    outline: shapely.Polygon | NDArray[np.float64],
    obstacles: Sequence[shapely.Polygon],
    spacing_m: float,
    density: Density = UNIFORM,
    clearance_m: float = 0.0,
) -> GeodesicGround:
    """Prepare a region with obstacles for control."""
    covered = geodesic_region(outline, obstacles, spacing_m, density, clearance_m)
    hull = convex_region(np.asarray(shapely.get_coordinates(covered.free.convex_hull)))
    if clearance_m == 0.0:
        return GeodesicGround(covered.free, covered, covered.nodes_m, spacing_m, hull)
    inner = geodesic_region(covered.allowed, (), 2.0 * hull.radius_m / DRIVE_NODES)
    nodes = inner.nearest(covered.nodes_m)
    region = replace(
        inner,
        nodes_m=nodes,
        mass=covered.mass,
        spread=covered.spread,
        corner_sees=inner.sees_each(nodes, inner.corners_m),
    )
    return GeodesicGround(covered.free, region, covered.nodes_m, spacing_m, hull)


def neighbour_network(ground: Ground, agents_m: NDArray[np.float64]) -> Network:
    """Return who talks to whom: Voronoi neighbours in the ground's hull, always connected."""
    # Agents that nearly touch count as being at one place: bisectors between them are rounding.
    places, group = merge_coincident(agents_m, TOUCHING * ground.hull.radius_m)
    cells = voronoi_cells(ground.hull, places[group])
    return Network(len(agents_m), agent_neighbours(cells))
