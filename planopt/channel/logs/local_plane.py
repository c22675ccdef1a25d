"""Longitudes and latitudes as metres east and north of an origin, on the plane that touches there.

Places on the ellipsoid WGS 84 are projected at right angles onto its tangent plane. Distances from
the origin come out too short by their cube over six squared radii of the earth: 4 mm at 10 km, 4 m
at 100 km.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EQUATOR_RADIUS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563

FARTHEST_M = 100_000.0
"""Distance from the origin up to which the plane is offered."""


def east_north_m(
    longitude_deg: NDArray[np.float64],
    latitude_deg: NDArray[np.float64],
    origin_deg: tuple[float, float],
) -> NDArray[np.float64]:
    """Project places onto the plane that touches the earth at the origin.

    Parameters
    ----------
    longitude_deg, latitude_deg
        ``(n,)`` on WGS 84, height zero.
    origin_deg
        Latitude and longitude of the place that becomes (0, 0).

    Returns
    -------
    ndarray
        ``(n, 2)`` metres to the east and to the north; NaN for places that are farther than
        `FARTHEST_M`.

    Examples
    --------
    >>> import numpy as np
    >>> east_north_m(np.array([11.5755]), np.array([48.1383]), (48.1374, 11.5755)).round(1)
    array([[  0. , 100.1]])
    """
    latitude, longitude = np.radians(origin_deg)
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    away = _from_the_centre_m(np.radians(longitude_deg), np.radians(latitude_deg))
    away -= _from_the_centre_m(longitude, latitude)
    plane = np.stack([away @ east, away @ np.cross(up, east)], axis=-1)
    plane[np.linalg.norm(away, axis=-1) > FARTHEST_M] = np.nan
    return plane


def _from_the_centre_m(
    longitude: NDArray[np.float64] | np.float64, latitude: NDArray[np.float64] | np.float64
) -> NDArray[np.float64]:
    """``(..., 3)`` places at height zero, from the centre of the earth."""
    squared_eccentricity = FLATTENING * (2.0 - FLATTENING)
    normal = EQUATOR_RADIUS_M / np.sqrt(1.0 - squared_eccentricity * np.sin(latitude) ** 2)
    return np.stack(
        [
            normal * np.cos(latitude) * np.cos(longitude),
            normal * np.cos(latitude) * np.sin(longitude),
            normal * (1.0 - squared_eccentricity) * np.sin(latitude),
        ],
        axis=-1,
    )
