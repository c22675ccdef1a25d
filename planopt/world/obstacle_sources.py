"""Obstacles from what Python has them in: geometries, tables of geometries, corners, grids."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, cast

import numpy as np
import shapely

from planopt.errors import InputError
from planopt.world.footprints import footprint
from planopt.world.occupancy_grid import OccupancyGrid, grid_obstacles
from planopt.world.readers import obstacles_of_geometry
from planopt.world.workspace import Obstacle


def obstacles_from(source: Any, name: str = "obstacle") -> tuple[Obstacle, ...]:
    """Return the obstacles of geometries, of a table of them, of corners or of a grid.

    Parameters
    ----------
    source
        A shapely polygon or collection of polygons; a GeoDataFrame or GeoSeries, whose column
        ``name`` names the obstacles if there is one; an array ``(n, 2)`` of the corners of one
        obstacle; an :class:`planopt.problems.OccupancyGrid`; or a list of any of these, obstacles
        included. Coordinates are metres in the frame of the problem.
    name
        Name of obstacles that have none of their own; several are numbered.

    Raises
    ------
    InputError
        Something is no area, or a polygon is invalid.

    Examples
    --------
    >>> import shapely
    >>> from planopt import obstacles_from
    >>> [each.name for each in obstacles_from([shapely.box(0, 0, 1, 1), [(3, 0), (4, 0), (4, 2)]])]
    ['obstacle 1', 'obstacle 2']
    """
    return tuple(_obstacles(source, name))


def _obstacles(source: Any, name: str) -> Iterator[Obstacle]:
    if isinstance(source, Obstacle):
        yield source
    elif isinstance(source, shapely.Geometry):
        yield from obstacles_of_geometry(name, source)
    elif isinstance(source, OccupancyGrid):
        yield from grid_obstacles(source, name)
    elif hasattr(source, "geometry"):
        geometries = list(cast("Iterable[Any]", source.geometry))
        names = _column_of_names(source, name, len(geometries))
        for own, geometry in zip(names, geometries, strict=True):
            yield from _obstacles(geometry, own)
    elif getattr(source, "dtype", None) == np.bool_:
        raise InputError(
            f"{name}: an array of bool {np.shape(source)} is no list of corners",
            key="world.obstacles",
            remedy="give its cells a place: planopt.problems.OccupancyGrid(occupied, unknown, "
            "resolution_m=0.5, origin_m=(0.0, 0.0)) with two arrays of bool",
        )
    elif _is_ring(source):
        yield footprint(name, cast("Any", np.asarray(source)).tolist())
    elif isinstance(source, Iterable) and not isinstance(source, str | bytes):
        entries = list(cast("Iterable[Any]", source))
        for number, entry in enumerate(entries, start=1):
            yield from _obstacles(entry, name if len(entries) == 1 else f"{name} {number}")
    else:
        raise InputError(
            f"{name}: a {type(source).__name__} is not an area",
            key="world.obstacles",
            remedy="give polygons, a GeoDataFrame, corners (n, 2) or an OccupancyGrid",
        )


def _column_of_names(table: Any, name: str, count: int) -> list[str]:
    """Return the names of the rows of a table of geometries."""
    if "name" in getattr(table, "columns", ()):
        return [str(own) for own in table["name"]]
    return [name if count == 1 else f"{name} {number}" for number in range(1, count + 1)]


def _is_ring(source: Any) -> bool:
    """Return whether something is a list or an array of corners."""
    try:
        corners = np.asarray(source, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return corners.ndim == 2 and corners.shape[1] == 2
