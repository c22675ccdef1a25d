"""Workspace: a rectangle with obstacles, whose footprints are validated on input.

Self-intersecting polygons are rejected, because distances to them would silently be wrong.
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
from planopt.parts import part_of, parts_of, plain
from planopt.short_repr import short_repr


@dataclass(frozen=True)
class Obstacle:
    """Static obstacle: a forbidden area, possibly for a limited time.

    Attributes
    ----------
    name
        Name of the obstacle in messages.
    polygon
        Simple polygon in metres, convex or not; holes are allowed.
    known_from_s, until_s
        Times in seconds at which the obstacle appears and disappears. Neither event is known in
        advance.
    """

    name: str
    polygon: shapely.Polygon
    known_from_s: float = 0.0
    until_s: float = math.inf

    @property
    def is_timed(self) -> bool:
        """Return whether the obstacle appears or disappears."""
        return self.known_from_s > 0.0 or self.until_s < math.inf

    def __post_init__(self) -> None:
        check_name(self.name)
        remedy = "planopt.obstacles_from converts corners, tables and grids to obstacles"
        part_of(f"the obstacle {self.name!r}", self.polygon, shapely.Polygon, remedy)
        if not self.polygon.is_valid or self.polygon.area == 0.0:
            raise InputError(
                f"the outline of {self.name!r} crosses itself, or has no area",
                key="world.obstacles",
                remedy="list the corners in order along the outline",
            )
        if not 0.0 <= self.known_from_s < self.until_s:
            raise InputError(
                f"{self.name!r} has known_from_s = {self.known_from_s!r} and until_s = "
                f"{self.until_s!r}, which are invalid",
                key="world.obstacles",
                remedy="give known_from_s of at least 0, and a larger until_s or None",
            )


class MotionKeys(Table):
    """Motion of a disc: start_m and velocity_m_s, or times_s and positions_m."""

    start_m: Pair | None = None
    """Centre [x, y] in metres at time 0, when planning begins."""
    velocity_m_s: Pair | None = None
    """Velocity [x, y] in m/s from start_m on, or after the last of times_s; by default, the disc
    then stops."""
    times_s: list[Annotated[float, Field(ge=0, le=1e7)]] | None = Field(default=None, min_length=1)
    """Increasing times in seconds at which the centre is at positions_m; it is at rest before the
    first one."""
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
                "other two out"
            )
        return self


@dataclass(frozen=True)
class MovingObstacle(Part):
    """Moving disc with a predicted, piecewise straight motion."""

    at = "world.moving[]"
    Keys = MotionKeys
    not_keys = frozenset({"times_s", "positions_m", "velocity_m_s"})

    name: Name
    """Name of the obstacle in messages and figures."""
    radius_m: Annotated[float, Field(gt=0, le=1e4)]
    """Radius of the disc in metres; robots keep constraints.clearance_m from it."""
    times_s: tuple[float, ...]
    """Increasing times in seconds at which the centre reaches positions_m; it is at rest before the
    first one."""
    positions_m: tuple[tuple[float, float], ...]
    """Centres [x, y] in metres at times_s."""
    velocity_m_s: tuple[float, float] = (0.0, 0.0)
    """Velocity [x, y] in m/s after the last of times_s."""
    position_std_m: Annotated[float, Field(ge=0, le=1e4)] = 0.0
    """Standard deviation of the predicted centre along each axis, in metres."""
    acceleration_std_m_s2: Annotated[float, Field(ge=0, le=1e3)] = 0.0
    """Standard deviation of the unpredicted acceleration along each axis, in m/s^2; the centre's
    error grows with prediction time."""
    probability: Annotated[float, Field(gt=0, lt=1)] = 0.99
    """Minimum probability per step that the error of the centre stays within the growth of the
    radius."""

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of the obstacle's table."""
        keys = super().to_keys() | {
            "times_s": list(self.times_s),
            "positions_m": list(self.positions_m),
            "velocity_m_s": self.velocity_m_s,
        }
        # The probability matters only for an uncertain prediction.
        if self.position_std_m == 0.0 and self.acceleration_std_m_s2 == 0.0:
            del keys["probability"]
        return keys

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the field values in a table; `start_m` becomes a track of one position."""
        values = super().of_keys(table) | {
            "times_s": tuple(table.times_s or [0.0]),
            "positions_m": tuple(table.positions_m or [table.start_m]),
            "velocity_m_s": table.velocity_m_s or (0.0, 0.0),
        }
        uncertain = table.position_std_m > 0.0 or table.acceleration_std_m_s2 > 0.0
        if "probability" in table.model_fields_set and not uncertain:
            raise fault_of(
                "has probability, which needs position_std_m or acceleration_std_m_s2: write "
                "for instance position_std_m = 0.5, or leave probability out"
            )
        return values

    def fault(self) -> str | None:
        """Return a message if times and positions are inconsistent; else None."""
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
    """Rectangle that bounds the robots, and its obstacles (W and O of [GM11]).

    Attributes
    ----------
    bounds_m
        ``(x_min, y_min, x_max, y_max)`` in metres.
    obstacles
        Static obstacles known at the start, permanent ones first. Create them by
        :func:`planopt.obstacles_from`.
    moving
        Moving obstacles with predicted motion.
    timed
        All obstacles that appear or disappear; by default those of `obstacles`.

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
        remedy = "planopt.obstacles_from converts polygons, tables and grids to obstacles"
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
            # `timed` keeps those that appear later; `obstacles` leaves them out for now.
            object.__setattr__(self, "obstacles", self.known_at(0.0))

    @property
    def lasting(self) -> tuple[Obstacle, ...]:
        """Obstacles that neither appear nor disappear."""
        timed = {id(one) for one in self.timed}
        return tuple(one for one in self.obstacles if id(one) not in timed)

    def known_at(self, time_s: float) -> tuple[Obstacle, ...]:
        """Return the obstacles present at `time_s`, permanent ones first."""
        # Times are sums of steps and have rounding errors.
        later_s = time_s + 1e-9 * max(1.0, abs(time_s))
        there = [one for one in self.timed if one.known_from_s <= later_s < one.until_s]
        return (*self.lasting, *there)


LONGEST_NAME = 200  # Maximum length of an obstacle's name, repeated in messages, tables and figures
MEETING_SEGMENTS = 50
"""Maximum mean number of intersecting segments; repairs are quadratic beyond it."""

SAMPLED_SEGMENTS = 200

SAME_AREA = 1e-9  # Relative tolerance within which a repair must preserve the area

_Ring = list[tuple[float, float]]


def footprint(name: str, exterior: object, holes: Iterable[object] = ()) -> Obstacle:
    """Return an obstacle with a validated exterior and validated holes."""
    check_name(name)
    shell = _ring(name, exterior)
    polygon = shapely.Polygon(shell, [_ring(name, hole) for hole in holes])
    if polygon.is_valid and polygon.area > 0:
        return Obstacle(name, polygon)
    # Repair of spikes and touching rings: without parts of zero area, the polygon is unambiguous.
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
        f"{name}: the polygon is invalid: {shapely.is_valid_reason(polygon)}"
        if polygon.area > 0
        else f"{name}: the polygon has no area",
        remedy="list the corners in order along the outline",
    )


def check_name(name: str) -> None:
    """Raise an InputError for an obstacle name that is too long or not printable text."""
    if not isinstance(cast("object", name), str):
        raise InputError(
            f"is {name!r}, should be text",
            key="world.obstacles[].name",
            remedy='give a name, such as "house"',
        )
    if len(name) > LONGEST_NAME:
        raise InputError(
            f"the name {name[:20]!r}... has {len(name)} characters, more than the limit of "
            f"{LONGEST_NAME}",
            remedy="shorten it",
        )
    if not name.isprintable():
        raise InputError(
            f"the name {name!a} contains a character that cannot be printed",
            remedy="use printable characters only",
        )


def _is_nearly_simple(polygon: shapely.Polygon) -> bool:
    """Return whether few outline segments intersect others, estimated from a sample."""
    corners = shapely.get_coordinates(polygon)
    segments = [shapely.LineString(ends) for ends in pairwise(corners)]
    sampled = segments[:: max(1, len(segments) // SAMPLED_SEGMENTS)]
    pairs = shapely.STRtree(segments).query(sampled)
    return pairs.shape[1] <= MEETING_SEGMENTS * len(sampled)


def _ring(name: str, ring: object) -> _Ring:
    """Return the corners (x, y) of a ring; heights are ignored."""
    if isinstance(ring, (str, bytes)) or not isinstance(ring, Iterable):
        raise InputError(
            f"{name}: a ring should be a list of corners (x, y), but is {ring!r}",
            remedy="give [[x, y], [x, y], [x, y]] in metres",
        )
    corners = [_corner(name, corner) for corner in cast("Iterable[object]", ring)]
    different = len(set(corners))
    if different < 3:
        raise InputError(
            f"{name}: a ring has only {different} different corners; three are needed",
            remedy="list the corners in order along the outline",
        )
    return corners


def _corner(name: str, corner: object) -> tuple[float, float]:
    """Return the validated x and y of a corner."""
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
    # The comparison precedes conversion, because a JSON integer may overflow a float.
    if not (abs(x) <= LARGEST_COORDINATE_M and abs(y) <= LARGEST_COORDINATE_M):
        raise InputError(
            f"{name}: the corner ({x}, {y}) is out of range",
            remedy=f"give finite coordinates within {LARGEST_COORDINATE_M:g} m of the origin",
        )
    return float(np.float64(x)), float(np.float64(y))


LONGEST_MOVE = math.sqrt(5.0)  # Length of the longest lattice move, in spacings


def node_estimate(workspace: Workspace, step_m: float) -> float:
    """Return an estimate of the number of lattice nodes within the bounds for steps `step_m`."""
    x_min, y_min, x_max, y_max = workspace.bounds_m
    spacing = step_m / LONGEST_MOVE
    return (x_max - x_min) / spacing * ((y_max - y_min) / spacing)
