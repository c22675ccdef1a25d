"""Where robots may be: a rectangle less the obstacles in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import shapely

from planopt.plain_values import part_of, parts_of, plain
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
    """

    name: str
    polygon: shapely.Polygon

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
        The forbidden areas, in the order of the problem file;
        :func:`planopt.obstacles_from` makes them of whatever has them.
    moving
        Obstacles that move as predicted.

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

    __repr__ = short_repr

    def __init__(
        self,
        bounds_m: Sequence[float],
        obstacles: Sequence[Obstacle] = (),
        moving: Sequence[MovingObstacle] = (),
    ) -> None:
        remedy = "planopt.obstacles_from makes obstacles of polygons, tables and grids"
        given = {
            "bounds_m": plain(bounds_m),
            "obstacles": parts_of("world.obstacles", obstacles, Obstacle, remedy),
            "moving": parts_of("world.moving", moving, MovingObstacle),
        }
        for key, value in given.items():
            object.__setattr__(self, key, value)
