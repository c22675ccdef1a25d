"""One checked obstacle from the rings of its footprint.

Everything that reads obstacles comes through here, so that no polygon that crosses itself reaches
the distance computations, where it would give wrong answers without an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from numbers import Real
from typing import cast

import numpy as np
import shapely

from planopt.errors import InputError
from planopt.world.workspace import Obstacle

LARGEST_COORDINATE_M = 1e9
"""Beyond this a coordinate is not a place on Earth in metres."""

LONGEST_NAME = 200
"""Characters in the name of an obstacle, which messages, tables and pictures repeat."""

MEETING_SEGMENTS = 50
"""An outline whose segments come near to more others than this is no outline: repairing it would
take time and memory that grow with the square of its corners."""

SAMPLED_SEGMENTS = 200

SAME_AREA = 1e-9
"""A repair that changes the area by no more than this share has changed no area."""

_Ring = list[tuple[float, float]]


def footprint(name: str, exterior: object, holes: Iterable[object] = ()) -> Obstacle:
    """Check the rings of a footprint and make it an obstacle."""
    check_name(name)
    shell = _ring(name, exterior)
    polygon = shapely.Polygon(shell, [_ring(name, hole) for hole in holes])
    if polygon.is_valid and polygon.area > 0:
        return Obstacle(name, polygon)
    # Spikes, rings that touch and the like: removing what has no area leaves one meaning only.
    repaired = (
        shapely.make_valid(polygon, method="structure", keep_collapsed=False)
        if _is_nearly_simple(polygon)
        else polygon
    )
    if (
        repaired is not polygon
        and isinstance(repaired, shapely.Polygon)
        and repaired.area > 0
        and math.isclose(repaired.area, polygon.area, rel_tol=SAME_AREA)
    ):
        return Obstacle(name, repaired)
    raise InputError(
        f"{name}: not a simple polygon: {shapely.is_valid_reason(polygon)}"
        if polygon.area > 0
        else f"{name}: the polygon has no area",
        remedy="list the corners in order along the outline",
    )


def check_name(name: str) -> None:
    """Refuse the name of an obstacle that cannot be written or shown."""
    if not isinstance(cast("object", name), str):
        raise InputError(
            f"is {name!r}, should be text",
            key="world.obstacles[].name",
            remedy='give a name, such as "house"',
        )
    if len(name) > LONGEST_NAME:
        raise InputError(
            f"the name {name[:20]!r}... has {len(name)} characters, more than {LONGEST_NAME}",
            remedy="shorten it",
        )
    if not name.isprintable():
        raise InputError(
            f"the name {name!a} has a character that cannot be printed", remedy="rename it"
        )


def _is_nearly_simple(polygon: shapely.Polygon) -> bool:
    """Return whether the segments of the outline keep to themselves, judged by some of them."""
    corners = shapely.get_coordinates(polygon)
    segments = [shapely.LineString(ends) for ends in pairwise(corners)]
    sampled = segments[:: max(1, len(segments) // SAMPLED_SEGMENTS)]
    pairs = shapely.STRtree(segments).query(sampled)
    return pairs.shape[1] <= MEETING_SEGMENTS * len(sampled)


def _ring(name: str, ring: object) -> _Ring:
    """Corners of `ring`, without heights."""
    if isinstance(ring, (str, bytes)) or not isinstance(ring, Iterable):
        raise InputError(
            f"{name}: a ring must be a list of (x, y) corners, not {ring!r}",
            remedy="give [[x, y], [x, y], [x, y]] in metres",
        )
    corners = [_corner(name, corner) for corner in cast("Iterable[object]", ring)]
    different = len(set(corners))
    if different < 3:
        raise InputError(
            f"{name}: a ring with {different} different corners; three are needed",
            remedy="list the corners in order along the outline",
        )
    return corners


def _corner(name: str, corner: object) -> tuple[float, float]:
    """The x and y of one corner."""
    values = (
        list(cast("Iterable[object]", corner))
        if isinstance(corner, Iterable) and not isinstance(corner, (str, bytes))
        else []
    )
    if len(values) < 2 or not all(
        not isinstance(value, bool) and isinstance(value, Real) for value in values[:2]
    ):
        raise InputError(
            f"{name}: corner {corner!r} is not a pair of numbers", remedy="give [x, y] in metres"
        )
    x, y = (cast("float", value) for value in values[:2])
    # Compared before they are made floats: a JSON integer may be too large for one.
    if not (abs(x) <= LARGEST_COORDINATE_M and abs(y) <= LARGEST_COORDINATE_M):
        raise InputError(
            f"{name}: corner ({x}, {y}) is not a place in metres",
            remedy=f"coordinates are finite and within {LARGEST_COORDINATE_M:g} m of the origin",
        )
    return float(np.float64(x)), float(np.float64(y))
