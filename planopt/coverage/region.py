"""Convex regions that a network covers, and the checks of what is given with them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.errors import InputError

ON_BORDER = 1e-9
"""A place this far outside, as a share of the region's radius, counts as on the border."""

FLAT = 1e-12
"""Sine of the turn at a vertex that still counts as straight."""


@dataclass(frozen=True, eq=False)
class ConvexRegion:
    """A bounded convex polygon without obstacles; :func:`convex_region` builds it."""

    # (k, 2) corners, counter-clockwise, not closed, none of them collinear
    corners_m: NDArray[np.float64]
    # (k, 2) outward unit normals of the sides that start at those corners
    normals: NDArray[np.float64]
    offsets_m: NDArray[np.float64]  # (k,): the region is where normals @ q <= offsets_m
    centre_m: NDArray[np.float64]  # (2,) centre of the bounding box
    radius_m: float  # Largest distance of a corner from the centre
    area_m2: float  # Area

    def excess_m(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far places ``(n, 2)`` are beyond the worst side; (n,), at most 0 inside."""
        return (places_m @ self.normals.T - self.offsets_m).max(axis=1)

    def contains(self, places_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether places ``(n, 2)`` are inside or on the border; (n,)."""
        return self.excess_m(places_m) <= ON_BORDER * self.radius_m

    def inset(self, margin_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return normals and offsets of the half-planes of the region shrunk by a margin."""
        return self.normals, self.offsets_m - margin_m


def convex_region(polygon: shapely.Polygon | NDArray[np.float64]) -> ConvexRegion:
    """Check a polygon and prepare it as a region to cover."""
    checked = checked_polygon(polygon)
    hull = checked.convex_hull
    missing_m2 = hull.area - checked.area
    if checked.interiors or missing_m2 > ON_BORDER * hull.area:
        raise InputError(
            "the region is not convex" if not checked.interiors else "the region has holes",
            key="region",
            remedy="cover it with geodesic cells",
        )
    corners = _corners(np.asarray(shapely.get_coordinates(hull), dtype=np.float64)[:-1])
    side = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(side[:, 0], side[:, 1])
    normals = np.stack((side[:, 1], -side[:, 0]), axis=1) / length[:, None]
    offsets = np.einsum("ij,ij->i", normals, corners)
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    radius = float(np.hypot(*(corners - centre).T).max())
    return ConvexRegion(corners, normals, offsets, centre, radius, float(hull.area))


def checked_polygon(polygon: shapely.Polygon | NDArray[np.float64]) -> shapely.Polygon:
    """Return a valid polygon with an area."""
    if isinstance(polygon, shapely.Polygon):
        coordinates = np.asarray(shapely.get_coordinates(polygon), dtype=np.float64)
    else:
        coordinates = np.asarray(polygon, dtype=np.float64)
    if coordinates.ndim != 2 or coordinates.shape[1] != 2 or len(coordinates) < 3:
        raise InputError(
            f"an outline of shape {coordinates.shape} is not a polygon",
            key="region",
            remedy="give at least three corners of two coordinates",
        )
    if not np.isfinite(coordinates).all():
        raise InputError("a corner of the region is not finite", key="region")
    candidate = polygon if isinstance(polygon, shapely.Polygon) else shapely.Polygon(coordinates)
    if not shapely.is_valid(candidate):
        raise InputError(
            f"the region's outline is not simple: {shapely.is_valid_reason(candidate)}",
            key="region",
            remedy="give corners in order, without crossings",
        )
    extent = float(np.ptp(coordinates, axis=0).max())
    if not candidate.area > ON_BORDER * extent**2:
        raise InputError("the region has no area", key="region")
    return candidate


def checked_places(
    region: ConvexRegion, places_m: NDArray[np.float64], key: str
) -> NDArray[np.float64]:
    """Return finite places ``(n, 2)`` of the region, n at least 1."""
    places = np.asarray(places_m, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 2 or not len(places):
        raise InputError(
            f"places of shape {places.shape} are given", key=key, remedy="give an array (n, 2)"
        )
    finite = np.asarray(np.isfinite(places).all(axis=1))
    outside = ~finite
    outside[finite] = ~region.contains(places[finite])
    if outside.any():
        which = int(outside.argmax())
        x, y = places[which]
        raise InputError(f"({x:g}, {y:g}) is not in the region", key=f"{key}[{which}]")
    return places


def positive(value: float, key: str, *, zero: bool = False) -> float:
    """Return a finite number above zero, or from zero on."""
    if not math.isfinite(value) or value < 0.0 or (value == 0.0 and not zero):
        least = "0 or more" if zero else "more than 0"
        raise InputError(f"{value!r} is out of range", key=key, remedy=f"give {least}")
    return value


def _corners(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drop collinear vertices of a convex ring ``(k, 2)`` and order it counter-clockwise."""
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    if turn.sum() < 0.0:
        return _corners(ring[::-1])
    return ring[turn > FLAT * np.hypot(*before.T) * np.hypot(*after.T)]
