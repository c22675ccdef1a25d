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
    """The coverage cost of a region, and the place where each agent should be.

    Attributes
    ----------
    cost
        The coverage cost H, in m^4 for the uniform density of 1 per m^2.
    mass
        ``(n,)`` mass of each agent's cell.
    centroids_m
        ``(n, 2)`` centroid of each agent's cell; the agent's own place if the cell has no mass.
    gradient
        ``(n, 2)`` derivative of H by each agent's place, ``2 M (p - C)``. Agents at one place share
        the derivative of the place in equal parts.
    """

    cost: float
    mass: NDArray[np.float64]
    centroids_m: NDArray[np.float64]
    gradient: NDArray[np.float64]


def coverage(
    cells: Cells, density: Density = UNIFORM, sensing_range_m: float | None = None
) -> Coverage:
    """Evaluate the coverage cost, its gradient and the centroids of all cells.

    Exact to rounding for the uniform density and for rasters; other densities are integrated by
    Gauss quadrature.

    Parameters
    ----------
    cells
        The partition, from :func:`planopt.coverage.voronoi.voronoi_cells`.
    density
        Weight of each place.
    sensing_range_m
        How far an agent senses; None without limit. Cells are cut at it.

    Raises
    ------
    InputError
        The density is negative or not finite somewhere, or the range is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from planopt.coverage.region import convex_region
    >>> from planopt.coverage.voronoi import voronoi_cells
    >>> square = convex_region(np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))
    >>> one = coverage(voronoi_cells(square, np.array([[0.5, 0.25]])))
    >>> round(one.cost, 6), one.centroids_m.round(6).tolist()
    (0.229167, [[0.5, 0.5]])
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
