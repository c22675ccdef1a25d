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
from typing import Annotated, Any, cast

import numpy as np
import shapely
from pydantic import Field, model_validator

from planopt.errors import InputError
from planopt.keys import LARGEST_COORDINATE_M, Name, Pair, Part, Table, fault_of
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
        check_name(self.name)
        remedy = "planopt.obstacles_from makes obstacles of corners, tables and grids"
        part_of(f"the obstacle {self.name!r}", self.polygon, shapely.Polygon, remedy)
        if not self.polygon.is_valid or self.polygon.area == 0.0:
            raise InputError(
                f"{self.name} crosses itself or has no area",
                key="world.obstacles",
                remedy="list the corners in order along the outline",
            )
        if not 0.0 <= self.known_from_s < self.until_s:
            raise InputError(
                f"{self.name} is known from {self.known_from_s!r} s until {self.until_s!r} s",
                key="world.obstacles",
                remedy="give known_from_s from 0 on, and a larger until_s or none",
            )


class MotionKeys(Table):
    """The motion of a disc: start_m and velocity_m_s, or times_s and positions_m."""

    start_m: Pair | None = None
    """Centre [x, y] in metres at time 0, when planning begins."""
    velocity_m_s: Pair | None = None
    """Velocity [x, y] in m/s, from start_m on or after the last of times_s; without it there, the
    disc stands."""
    times_s: list[Annotated[float, Field(ge=0, le=1e7)]] | None = Field(default=None, min_length=1)
    """Times in seconds, increasing, at which the centre is at positions_m; it stands before the
    first."""
    positions_m: list[Pair] | None = Field(default=None, min_length=1)
    """Centres [x, y] in metres at times_s."""

    @model_validator(mode="after")
    def _one_motion(self) -> MotionKeys:
        straight = self.start_m is not None and self.velocity_m_s is not None
        timed = self.times_s is not None and self.positions_m is not None
        given = sum(each is not None for each in (self.start_m, self.times_s, self.positions_m))
        if not (straight and given == 1) and not (timed and given == 2):
            raise fault_of(
                "needs either start_m and velocity_m_s, or times_s and positions_m: leave the "
                "others out",
            )
        return self


@dataclass(frozen=True)
class MovingObstacle(Part):
    """A disc that moves as predicted: straight between known positions."""

    at = "world.moving[]"
    Keys = MotionKeys
    not_keys = frozenset({"times_s", "positions_m", "velocity_m_s"})

    name: Name
    """What messages and pictures call it."""
    radius_m: Annotated[float, Field(gt=0, le=1e4)]
    """Radius of the disc in metres; constraints.clearance_m is kept from it."""
    times_s: tuple[float, ...]
    """Increasing times in seconds at which the centre is at positions_m; it stands before the
    first."""
    positions_m: tuple[tuple[float, float], ...]
    """Centres [x, y] in metres at times_s."""
    velocity_m_s: tuple[float, float] = (0.0, 0.0)
    """Velocity [x, y] in m/s after the last of times_s."""
    position_std_m: Annotated[float, Field(ge=0, le=1e4)] = 0.0
    """Standard deviation in metres, along each axis, of the predicted centre."""
    acceleration_std_m_s2: Annotated[float, Field(ge=0, le=1e3)] = 0.0
    """Standard deviation in m/s^2, along each axis, of an acceleration that is not predicted; the
    centre's error grows with the time ahead."""
    probability: Annotated[float, Field(gt=0, lt=1)] = 0.99
    """Least probability, for each step, that the centre stays within the growth of the radius for
    these deviations."""

    @property
    def is_uncertain(self) -> bool:
        """Return whether its path is uncertain: only then does the probability matter."""
        return self.position_std_m > 0.0 or self.acceleration_std_m_s2 > 0.0

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of its table."""
        keys = super().to_keys() | {
            "times_s": list(self.times_s),
            "positions_m": list(self.positions_m),
            "velocity_m_s": self.velocity_m_s,
        }
        if not self.is_uncertain:
            del keys["probability"]
        return keys

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the fields; a disc that moves straight has one position."""
        values = super().of_keys(table) | {
            "times_s": tuple(table.times_s or [0.0]),
            "positions_m": tuple(table.positions_m or [table.start_m]),
            "velocity_m_s": table.velocity_m_s or (0.0, 0.0),
        }
        uncertain = table.position_std_m > 0.0 or table.acceleration_std_m_s2 > 0.0
        if "probability" in table.model_fields_set and not uncertain:
            raise fault_of(
                "has probability, which needs position_std_m or acceleration_std_m_s2: write "
                "position_std_m = 0.5, or leave probability out",
            )
        return values

    def fault(self) -> str | None:
        """Return how times and positions do not fit."""
        if len(self.times_s) != len(self.positions_m):
            return (
                f"has {len(self.times_s)} times_s and {len(self.positions_m)} positions_m: give a "
                "place for each time"
            )
        if any(later <= earlier for earlier, later in pairwise(self.times_s)):
            return "has times_s that do not increase: sort them"
        return None


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
        """Return the obstacles that always stand there."""
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
    """Return whether few segments of the outline meet others, by a sample of them."""
    corners = shapely.get_coordinates(polygon)
    segments = [shapely.LineString(ends) for ends in pairwise(corners)]
    sampled = segments[:: max(1, len(segments) // SAMPLED_SEGMENTS)]
    pairs = shapely.STRtree(segments).query(sampled)
    return pairs.shape[1] <= MEETING_SEGMENTS * len(sampled)


def _ring(name: str, ring: object) -> _Ring:
    """Return the corners of a ring, without heights."""
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
    """Return x and y of a corner."""
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
