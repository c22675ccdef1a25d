"""Where robots may be: a rectangle less the obstacles in it."""

from __future__ import annotations

from dataclasses import dataclass

import shapely

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


@dataclass(frozen=True)
class Workspace:
    """The workspace W and its obstacles O (W and O of [GM11]).

    Attributes
    ----------
    bounds_m
        ``(x_min, y_min, x_max, y_max)`` in metres.
    obstacles
        The forbidden areas, in the order of the problem file.
    moving
        Obstacles that move as predicted.
    """

    bounds_m: tuple[float, float, float, float]
    obstacles: tuple[Obstacle, ...]
    moving: tuple[MovingObstacle, ...] = ()

    __repr__ = short_repr
