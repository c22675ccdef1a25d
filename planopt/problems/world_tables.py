"""``[world]``: the workspace, its obstacles, and those that move; also as saved."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import shapely
from pydantic import Field, model_validator

from planopt.errors import InputError
from planopt.keys import FileName, Pair, Quad, ReadAs, Table, fault_of, saved
from planopt.world.occupancy_files import is_grid
from planopt.world.occupancy_grid import UnknownCells
from planopt.world.readers import obstacle_from_wkt, read_obstacles
from planopt.world.workspace import MovingObstacle, Obstacle, Workspace, footprint


class ObstacleTable(Table):
    """One entry of ``obstacles``: exactly one of ``file``, ``polygon`` and ``wkt``."""

    name: str | None = None
    """What messages call it, for polygon and wkt; a file's obstacles have names."""
    file: FileName | None = None
    """GeoJSON (.geojson), WKT (.wkt), building file (.json) or occupancy grid (.yaml as in ROS,
    .csv), in metres, relative to the problem file."""
    unknown: UnknownCells = "occupied"
    """What unknown cells of an occupancy grid are taken for: occupied or free."""
    polygon: list[Pair] | None = Field(default=None, min_length=3)
    """Outer ring, a list of [x, y] in metres."""
    holes: tuple[Annotated[list[Pair], Field(min_length=3)], ...] = Field(default=(), strict=False)
    """Rings of holes in polygon, each a list of [x, y] in metres."""
    wkt: str | None = Field(default=None, min_length=1)
    """A POLYGON in metres."""
    known_from_s: float = Field(default=Obstacle.known_from_s, ge=0, le=1e9)
    """Time of the run in seconds from which on it stands there; no plan made before knows of it."""
    until_s: float | None = Field(default=None, gt=0, le=1e9)
    """Time in seconds from which on it is gone, which nobody knows before; without it, it stays."""

    @model_validator(mode="after")
    def _one_source(self) -> ObstacleTable:
        given = [key for key in ("file", "polygon", "wkt") if getattr(self, key) is not None]
        if len(given) != 1:
            raise fault_of(
                f"needs exactly one of file, polygon and wkt, has {' and '.join(given) or 'none'}: "
                "write polygon = [[x, y], ...] in metres, for instance"
            )
        if self.holes and self.polygon is None:
            raise fault_of("has holes, which go only with polygon: a file and wkt have their own")
        if "unknown" in self.model_fields_set and not is_grid(self.file):
            raise fault_of(
                "has unknown, which goes only with the file of an occupancy grid: leave it out",
            )
        if self.until_s is not None and self.until_s <= self.known_from_s:
            raise fault_of("has until_s that is not after known_from_s: give a later one, or none")
        if self.name is not None and self.file is not None:
            raise fault_of(
                "has a name, which goes only with polygon and wkt, beside file: leave it out, "
                "since a file has names of its own",
            )
        return self


class WorldTable(Table):
    """``[world]``: where robots may be."""

    bounds_m: Quad
    """[x_min, y_min, x_max, y_max] in metres."""
    obstacles: tuple[ObstacleTable, ...] = Field(default=(), strict=False)
    """The forbidden areas."""
    moving: tuple[MovingObstacle, ...] = Field(default=(), strict=False, max_length=50)
    """Obstacles that move as predicted."""


def _workspace_of(table: WorldTable, folder: Path) -> Workspace:
    """Return the workspace that a table describes, its obstacles read from their files."""
    obstacles = [
        replace(
            obstacle,
            known_from_s=entry.known_from_s,
            until_s=math.inf if entry.until_s is None else entry.until_s,
        )
        for index, entry in enumerate(table.obstacles)
        for obstacle in obstacles_of(entry, index, folder)
    ]
    return Workspace(table.bounds_m, obstacles, table.moving)


def _world_keys(workspace: Workspace) -> dict[str, Any]:
    """Return the keys of a workspace from Python, but for its obstacles, which are checked."""
    return {"bounds_m": workspace.bounds_m, "moving": workspace.moving}


WORLD = ReadAs(WorldTable, _workspace_of, Workspace, to_keys=_world_keys, needs_folder=True)


def obstacles_of(table: ObstacleTable, index: int, folder: Path) -> tuple[Obstacle, ...]:
    """Return the obstacles of one entry of ``world.obstacles``; errors carry its key."""
    key = f"world.obstacles[{index}]"
    name = f"obstacle {index}" if table.name is None else table.name
    try:
        if table.file is not None:
            return read_obstacles(folder / table.file, table.unknown)
        if table.wkt is not None:
            return (obstacle_from_wkt(name, table.wkt),)
        return (footprint(name, table.polygon, table.holes),)
    except InputError as error:
        raise InputError(
            error.message,
            file=error.file,
            key=error.key or key,
            row=error.row,
            remedy=error.remedy,
        ) from error


def world_table(workspace: Workspace) -> dict[str, Any]:
    """Return ``[world]`` in full, with obstacles as polygons."""
    return {
        "bounds_m": list(workspace.bounds_m),
        "obstacles": [obstacle_table(each) for each in (*workspace.lasting, *workspace.timed)],
        "moving": saved(workspace.moving),
    }


def obstacle_table(obstacle: Obstacle) -> dict[str, Any]:
    """Return an obstacle as an entry of ``world.obstacles``."""
    polygon = obstacle.polygon
    table: dict[str, Any] = {"name": obstacle.name, "polygon": _ring(polygon.exterior)}
    if obstacle.known_from_s > 0.0:
        table["known_from_s"] = obstacle.known_from_s
    if obstacle.until_s < math.inf:
        table["until_s"] = obstacle.until_s
    holes = [_ring(ring) for ring in shapely.get_rings(polygon)[1:]]
    return {**table, "holes": holes} if holes else table


def _ring(ring: shapely.LinearRing) -> list[list[float]]:
    return shapely.get_coordinates(ring).tolist()
