"""The workspace: a rectangle less the obstacles in it, each checked when its footprint is read.

No polygon that crosses itself reaches the distance computations, where it would give wrong results
without an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from numbers import Real
from typing import Any, cast

import numpy as np
import shapely

from planopt.errors import InputError
from planopt.keys import LARGEST_COORDINATE_M
from planopt.parts import part_of, parts_of
from planopt.plain_values import plain
from planopt.short_repr import short_repr


@dataclass(frozen=True)
class Obstacle:
    """One forbidden area.

    Attributes
    ----------
    name
        What messages call it.
    polygon
        A simple polygon in metres, holes allowed, convex or not.
    known_from_s, until_s
        Seconds from when on it stands there and is known, and from when on it is gone. Nobody
        knows of either before.
    """

    name: str
    polygon: shapely.Polygon
    known_from_s: float = 0.0
    until_s: float = math.inf

    @property
    def is_timed(self) -> bool:
        """Return whether it comes or goes."""
        return self.known_from_s > 0.0 or self.until_s < math.inf

    def __post_init__(self) -> None:
        remedy = "planopt.obstacles_from makes obstacles of corners, tables and grids"
        part_of(f"the obstacle {self.name!r}", self.polygon, shapely.Polygon, remedy)


@dataclass(frozen=True)
class MovingObstacle:
    """A disc that moves as predicted.

    Attributes
    ----------
    name
        What messages call it.
    radius_m
        Radius of the disc.
    times_s, positions_m
        Positions of its centre at increasing times; it stands before the first and moves straight
        between.
    velocity_m_s
        Velocity after the last.
    position_std_m, acceleration_std_m_s2
        Standard deviations of the predicted centre along each axis: now, and of its acceleration.
    probability
        Least probability that the centre stays within the growth of the disc during a step.
    """

    name: str
    radius_m: float
    times_s: tuple[float, ...]
    positions_m: tuple[tuple[float, float], ...]
    velocity_m_s: tuple[float, float] = (0.0, 0.0)
    position_std_m: float = 0.0
    acceleration_std_m_s2: float = 0.0
    probability: float = 0.99

    @property
    def is_uncertain(self) -> bool:
        """Return whether its path is uncertain: only then does the probability matter."""
        return self.position_std_m > 0.0 or self.acceleration_std_m_s2 > 0.0


@dataclass(frozen=True, init=False)
class Workspace:
    """The rectangle that robots may be in, and its obstacles (W and O of [GM11]).

    Attributes
    ----------
    bounds_m
        ``(x_min, y_min, x_max, y_max)`` in metres.
    obstacles
        The forbidden areas that are known now, at the start; first those that always stand there.
        :func:`planopt.obstacles_from` makes them of whatever has them.
    moving
        Obstacles that move as predicted.
    timed
        All obstacles that come or go. By default those of `obstacles`.

    Examples
    --------
    >>> import shapely
    >>> from planopt import Obstacle, Workspace
    >>> house = Obstacle("house", shapely.box(10, 10, 18, 20))
    >>> len(Workspace((0, 0, 40, 30), [house]).obstacles)
    1
    """

    bounds_m: tuple[float, float, float, float]
    obstacles: tuple[Obstacle, ...]
    moving: tuple[MovingObstacle, ...]
    timed: tuple[Obstacle, ...]

    __repr__ = short_repr

    def __init__(
        self,
        bounds_m: Sequence[float],
        obstacles: Sequence[Obstacle] = (),
        moving: Sequence[MovingObstacle] = (),
        timed: Sequence[Obstacle] | None = None,
    ) -> None:
        remedy = "planopt.obstacles_from makes obstacles of polygons, tables and grids"
        key = "world.obstacles"
        standing = parts_of(key, obstacles, Obstacle, remedy)
        given: dict[str, Any] = {
            "bounds_m": plain(bounds_m),
            "obstacles": standing,
            "moving": parts_of("world.moving", moving, MovingObstacle),
            "timed": tuple(one for one in standing if one.is_timed)
            if timed is None
            else parts_of(key, timed, Obstacle, remedy),
        }
        for name, value in given.items():
            object.__setattr__(self, name, value)
        if timed is None and self.timed:
            # They are given together: what is not there yet is left out until it is.
            object.__setattr__(self, "obstacles", self.known_at(0.0))

    @property
    def lasting(self) -> tuple[Obstacle, ...]:
        """The obstacles that always stand there."""
        timed = {id(one) for one in self.timed}
        return tuple(one for one in self.obstacles if id(one) not in timed)

    def known_at(self, time_s: float) -> tuple[Obstacle, ...]:
        """Return the obstacles that stand there at a time: first those that always do."""
        # Times are sums of steps, which are rounded.
        later_s = time_s + 1e-9 * max(1.0, abs(time_s))
        there = [one for one in self.timed if one.known_from_s <= later_s < one.until_s]
        return (*self.lasting, *there)


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


LONGEST_MOVE = math.sqrt(5.0)
"""Length of the longest move in spacings."""


def node_estimate(workspace: Workspace, step_m: float) -> float:
    """Return about how many nodes a lattice for steps of `step_m` has within the bounds."""
    x_min, y_min, x_max, y_max = workspace.bounds_m
    spacing = step_m / LONGEST_MOVE
    return (x_max - x_min) / spacing * ((y_max - y_min) / spacing)
