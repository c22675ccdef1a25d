"""The coverage cost, its gradient, and the centroids that agents move to.

``H(p) = sum over cells of the integral of |q - p_i|^2 rho(q) dq``. With a sensing range R a place
that no agent senses costs ``R^2 rho(q)`` instead, so that H stays continuous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.boundary import cell_boundary, region_boundary
from planopt.coverage.density import Density, UniformDensity
from planopt.coverage.voronoi import Cells

UNIFORM = UniformDensity()
"""The density where none is given."""

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
