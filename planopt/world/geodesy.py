"""Positions in degrees (WGS 84) and metres along the axes of an origin, by default east and north.

The projection onto the tangent plane at the origin shortens a distance d by d^3 / (6 R^2), with R
the earth's radius: 4 mm at 10 km, 4 m at 100 km.
"""

import math

import numpy as np

from planopt.arrays import Floats
from planopt.errors import InputError

LARGEST_LATITUDE_DEG, LARGEST_LONGITUDE_DEG, LARGEST_TURN_DEG = 90.0, 180.0, 360.0

EQUATOR_RADIUS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563

FARTHEST_M = 100_000.0  # Maximum distance from the origin, in metres
INVERSE_STEPS = 6
"""Newton steps of the inverse projection; four suffice for rounding accuracy at `FARTHEST_M`."""
Origin = tuple[float, float] | tuple[float, float, float]
"""Latitude and longitude of (0, 0), and the angle from east to the x axis, in degrees."""


def parse_origin(text: str) -> Origin:
    """Return the origin in a text ``LAT,LON`` or ``LAT,LON,ANGLE`` in degrees."""
    key = "--origin"
    require_points(text, key, "ANGLE")
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    return require_origin(numbers, key, text)


def require_points(text: str, key: str, third: str) -> None:
    """Raise an InputError if a text of three parts may be two numbers with decimal commas."""
    parts = text.split(",")
    if len(parts) == 3 and not ("." in parts[0] and "." in parts[1]):
        raise InputError(
            f"{text!r} may have a decimal comma",
            key=key,
            remedy=f"write LAT,LON with decimal points, such as 48.1,11.0; LAT,LON,{third} needs a "
            "point in LAT and in LON",
        )


def require_origin(origin_deg: tuple[float, ...], key: str, shown: object = None) -> Origin:
    """Return a validated origin, or raise an InputError, for instance at a pole."""
    match origin_deg:
        case (latitude, longitude, *turn) if (
            len(turn) < 2
            and abs(latitude) < LARGEST_LATITUDE_DEG
            and abs(longitude) <= LARGEST_LONGITUDE_DEG
            and all(abs(angle) <= LARGEST_TURN_DEG for angle in turn)
        ):
            return (latitude, longitude, turn[0]) if turn else (latitude, longitude)
        case _:
            raise InputError(
                f"cannot read {origin_deg if shown is None else shown!r}",
                key=key,
                remedy="write LAT,LON in degrees, south and west negative; LAT,LON,ANGLE if the x "
                "axis is rotated by ANGLE degrees from east, counter-clockwise",
            )


def east_north_m(longitude_deg: Floats, latitude_deg: Floats, origin_deg: Origin) -> Floats:
    """Return positions projected onto the tangent plane at the origin; NaN beyond `FARTHEST_M`."""
    # Shapes: longitude_deg, latitude_deg (n,); returns (n, 2) along the axes of the origin.
    axes = _axes(origin_deg)
    away = _geocentric_m(np.radians(longitude_deg), np.radians(latitude_deg))
    latitude, longitude = np.radians(origin_deg[:2])
    away -= _geocentric_m(longitude, latitude)
    plane = away @ axes.T
    plane[np.linalg.norm(away, axis=-1) > FARTHEST_M] = np.nan
    return plane


def longitude_latitude_deg(positions_m: Floats, origin_deg: Origin) -> Floats:
    """Return longitudes and latitudes (n, 2) of positions in metres along the origin's axes."""
    # This inverts `east_north_m` by Newton's method.
    axes = _axes(origin_deg)
    latitude, longitude = (np.full(len(positions_m), each) for each in np.radians(origin_deg[:2]))
    start = _geocentric_m(*np.radians(origin_deg[:2])[::-1])
    for _ in range(INVERSE_STEPS):
        error = positions_m - (_geocentric_m(longitude, latitude) - start) @ axes.T
        # Unit vectors east and north at the estimate, projected onto the plane
        east = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros_like(longitude)], axis=-1)
        north = np.stack(
            [
                -np.sin(latitude) * np.cos(longitude),
                -np.sin(latitude) * np.sin(longitude),
                np.cos(latitude),
            ],
            axis=-1,
        )
        seen = np.stack([east @ axes.T, north @ axes.T], axis=-1)
        moved = np.linalg.solve(seen, error[..., None])[..., 0]
        across, along = _radii_m(latitude)
        longitude = longitude + moved[:, 0] / (across * np.cos(latitude))
        latitude = latitude + moved[:, 1] / along
    degrees = np.degrees(np.stack([longitude, latitude], axis=-1))
    degrees[:, 0] = (degrees[:, 0] + 180.0) % 360.0 - 180.0
    return degrees


def _axes(origin_deg: Origin) -> Floats:
    """Return the geocentric unit vectors (2, 3) of the x and y axes at the origin."""
    latitude, longitude = np.radians(origin_deg[:2])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    turn = math.radians(turn_deg(origin_deg))
    turned = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    return turned @ np.stack([east, np.cross(up, east)])


def turn_deg(origin_deg: Origin) -> float:
    """Return the angle in degrees, counter-clockwise, from east to the x axis."""
    return origin_deg[2] if len(origin_deg) == 3 else 0.0


def plane_of(origin_deg: Origin) -> str:
    """Return the PROJ definition of the tangent plane at an origin, without its rotation."""
    latitude, longitude = map(float, origin_deg[:2])
    return f"+proj=ortho +lat_0={latitude!r} +lon_0={longitude!r} +ellps=WGS84 +units=m +no_defs"


def _radii_m(latitude: Floats | np.float64) -> tuple[Floats | np.float64, Floats | np.float64]:
    """Return the radii of curvature across and along the meridian."""
    squared_eccentricity = FLATTENING * (2.0 - FLATTENING)
    root = np.sqrt(1.0 - squared_eccentricity * np.sin(latitude) ** 2)
    across = EQUATOR_RADIUS_M / root
    return across, across * (1.0 - squared_eccentricity) / root**2


def _geocentric_m(longitude: Floats | np.float64, latitude: Floats | np.float64) -> Floats:
    """Return geocentric coordinates (..., 3) of positions at height zero."""
    squared_eccentricity = FLATTENING * (2.0 - FLATTENING)
    normal, _ = _radii_m(latitude)
    return np.stack(
        [
            normal * np.cos(latitude) * np.cos(longitude),
            normal * np.cos(latitude) * np.sin(longitude),
            normal * (1.0 - squared_eccentricity) * np.sin(latitude),
        ],
        axis=-1,
    )
