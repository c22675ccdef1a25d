"""The workspace: a rectangle less the obstacles in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import shapely

from planopt.parts import part_of, parts_of
from planopt.plain_values import plain
from planopt.short_repr import short_repr
from planopt.world.moving_obstacle import MovingObstacle


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
