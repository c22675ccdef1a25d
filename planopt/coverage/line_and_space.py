"""Coverage of an interval and of a convex polyhedron with uniform density.

The control laws only need centroids, so that they hold in one and three dimensions as they stand.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, Voronoi

from planopt.coverage.cost import Coverage
from planopt.coverage.region import ON_BORDER
from planopt.coverage.voronoi import COINCIDENT, merge_coincident
from planopt.errors import InputError

INWARD = 1e-9
"""An agent nearer to a face than this share of the radius is looked at that far inside: otherwise
its mirror image would coincide with it."""


def line_coverage(low_m: float, high_m: float, agents_m: NDArray[np.float64]) -> Coverage:
    """Evaluate coverage of an interval by agents on it."""
    # Shapes: agents_m (n, 1).
    if not (np.isfinite([low_m, high_m]).all() and low_m < high_m):
        raise InputError(f"[{low_m:g}, {high_m:g}] is not an interval", key="region")
    places = _checked(agents_m, 1)
    outside = ~((places[:, 0] >= low_m) & (places[:, 0] <= high_m))
    _reject(places, outside)
    generators, cell_of = merge_coincident(places, COINCIDENT * (high_m - low_m))
    order = np.argsort(generators[:, 0])
    x = generators[order, 0]
    middles = 0.5 * (x[1:] + x[:-1])
    edges = np.concatenate(([low_m], middles, [high_m]))
    left, right = edges[:-1] - x, edges[1:] - x
    mass, first, second = np.empty(len(x)), np.empty(len(x)), np.empty(len(x))
    mass[order] = right - left
    first[order] = 0.5 * (right**2 - left**2)
    second[order] = (right**3 - left**3) / 3.0
    return _coverage(generators, cell_of, mass, first[:, None], second)


def space_coverage(corners_m: NDArray[np.float64], agents_m: NDArray[np.float64]) -> Coverage:
    """Evaluate coverage of a convex polyhedron by agents in it.

    Mirror images of all agents in every face make the faces edges of the Voronoi diagram.
    """
    # Shapes: corners_m (k, 3); agents_m (n, 3).
    normals, offsets, middle, radius = _faces(np.asarray(corners_m, dtype=np.float64))
    places = _checked(agents_m, 3)
    scaled = (places - middle) / radius
    _reject(places, np.asarray((scaled @ normals.T - offsets > ON_BORDER).any(axis=1)))
    generators, cell_of = merge_coincident(scaled, COINCIDENT)
    inner = generators.copy()
    # A corner of the region has several faces: a few rounds leave all of them.
    for _ in range(4):
        for normal, offset in zip(normals, offsets, strict=True):
            excess = np.maximum(inner @ normal - offset + INWARD, 0.0)
            inner -= excess[:, None] * normal
    images = [
        inner - 2.0 * (inner @ normal - offset)[:, None] * normal
        for normal, offset in zip(normals, offsets, strict=True)
    ]
    diagram = Voronoi(np.concatenate((inner, *images)))
    count = len(inner)
    cell, spokes = _tetrahedra(diagram.ridge_points, diagram.ridge_vertices, count)
    a, b, c = (diagram.vertices[spokes[:, k]] - inner[cell] for k in range(3))
    six = np.abs((a * np.cross(b, c)).sum(axis=1))
    total = a + b + c
    squares = (a * a + b * b + c * c + total * total).sum(axis=1)
    sums = np.zeros((count, 5))
    np.add.at(sums, cell, six[:, None] * np.column_stack((np.ones(len(six)), total, squares)))
    return _coverage(
        middle + radius * generators,
        cell_of,
        radius**3 * sums[:, 0] / 6.0,
        radius**4 * sums[:, 1:4] / 24.0,
        radius**5 * sums[:, 4] / 120.0,
    )


def _coverage(
    generators_m: NDArray[np.float64],
    cell_of: NDArray[np.intp],
    mass: NDArray[np.float64],
    first: NDArray[np.float64],
    second: NDArray[np.float64],
) -> Coverage:
    """The result of moments (g,), (g, d) and (g,) about the generators (g, d)."""
    centroids = generators_m + first / mass[:, None]
    multiplicity = np.bincount(cell_of)
    share = -2.0 * first / multiplicity[:, None]
    return Coverage(float(second.sum()), mass[cell_of], centroids[cell_of], share[cell_of])


def _checked(agents_m: NDArray[np.float64], dimension: int) -> NDArray[np.float64]:
    """Agents as a finite array (n, d), n at least 1."""
    places = np.asarray(agents_m, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != dimension or not len(places):
        raise InputError(
            f"places of shape {places.shape} are given",
            key="agents",
            remedy=f"give an array (n, {dimension})",
        )
    _reject(places, np.asarray(~np.isfinite(places).all(axis=1)))
    return places


def _reject(places: NDArray[np.float64], wrong: NDArray[np.bool_]) -> None:
    """Raise for the first agent that is wrong."""
    if wrong.any():
        which = int(wrong.argmax())
        raise InputError(f"{places[which].tolist()} is not in the region", key=f"agents[{which}]")


def _faces(
    corners: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """Faces of a convex hull about its middle and in units of its radius.

    Returns outward normals (f, 3), offsets (f,), the middle (3,) and the radius in metres.
    """
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.isfinite(corners).all():
        raise InputError("corners are finite and of three coordinates", key="region")
    if len(corners) < 4 or not np.ptp(corners, axis=0).all():
        raise InputError("the region has no volume", key="region")
    try:
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        radius = 0.5 * float(np.linalg.norm(np.ptp(corners, axis=0)))
        hull = ConvexHull((corners - middle) / radius)
    except QhullError as error:
        raise InputError("the region has no volume", key="region") from error
    # Faces that qhull cut into triangles come once for each of them.
    equations = np.unique(np.round(hull.equations, 12), axis=0)
    return equations[:, :3], -equations[:, 3], middle, radius


def _tetrahedra(
    pairs: NDArray[np.int32], faces: list[list[int]], count: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Cut the pyramids between cells and their faces into tetrahedra.

    Returns the cell (t,) of each of them, for the first `count` cells, and the three corners
    (t, 3) opposite the cell's generator. Faces list their corners in order.
    """
    cells: list[int] = []
    spokes: list[tuple[int, int, int]] = []
    for pair, face in zip(pairs.tolist(), faces, strict=True):
        for cell in pair:
            if cell < count:
                for second, third in itertools.pairwise(face[1:]):
                    cells.append(cell)
                    spokes.append((face[0], second, third))
    return np.array(cells, dtype=np.intp), np.array(spokes, dtype=np.intp).reshape(-1, 3)
