"""``[world]``: the workspace, its obstacles, and those that move; also as saved."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import shapely
from pydantic import Field, model_validator

from planopt.errors import InputError
from planopt.keys import FileName, Name, Pair, Quad, ReadAs, Table, fault_of, saved
from planopt.world.occupancy_files import is_grid
from planopt.world.occupancy_grid import UnknownCells
from planopt.world.readers import obstacle_from_wkt, read_obstacles
from planopt.world.workspace import MovingObstacle, Obstacle, Workspace, check_name, footprint


class MovingTable(Table):
    """One disc: ``start_m`` and ``velocity_m_s``, or ``times_s`` and ``positions_m``."""

    name: Name
    """What messages and pictures call it."""
    radius_m: float = Field(gt=0, le=1e4)
    """Radius of the disc in metres; constraints.clearance_m is kept from it."""
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
    position_std_m: float = Field(default=0.0, ge=0, le=1e4)
    """Standard deviation in metres, along each axis, of the predicted centre."""
    acceleration_std_m_s2: float = Field(default=0.0, ge=0, le=1e3)
    """Standard deviation in m/s^2, along each axis, of an acceleration that is not predicted; the
    centre's error grows with the time ahead."""
    probability: float = Field(default=MovingObstacle.probability, gt=0, lt=1)
    """Least probability, for each step, that the centre keeps within what the radius is grown by
    for these deviations."""

    @model_validator(mode="after")
    def _one_motion(self) -> MovingTable:
        straight = self.start_m is not None and self.velocity_m_s is not None
        timed = self.times_s is not None and self.positions_m is not None
        given = sum(each is not None for each in (self.start_m, self.times_s, self.positions_m))
        if not (straight and given == 1) and not (timed and given == 2):
            raise fault_of(
                "needs either start_m and velocity_m_s, or times_s and positions_m: leave the "
                "others out",
            )
        if "probability" in self.model_fields_set and not self.obstacle.is_uncertain:
            raise fault_of(
                "has probability, which needs position_std_m or acceleration_std_m_s2: write "
                "position_std_m = 0.5, or leave probability out",
            )
        if self.times_s is not None and self.positions_m is not None:
            if len(self.times_s) != len(self.positions_m):
                raise fault_of(
                    f"has {len(self.times_s)} times_s and {len(self.positions_m)} positions_m: "
                    "give a place for each time"
                )
            if any(later <= earlier for earlier, later in pairwise(self.times_s)):
                raise fault_of("has times_s that do not increase: sort them")
        return self

    @property
    def obstacle(self) -> MovingObstacle:
        """The obstacle that it describes."""
        times, places = self.times_s or [0.0], self.positions_m or [self.start_m or (0.0, 0.0)]
        return MovingObstacle(
            name=self.name,
            radius_m=self.radius_m,
            times_s=tuple(times),
            positions_m=tuple(places),
            velocity_m_s=self.velocity_m_s or (0.0, 0.0),
            position_std_m=self.position_std_m,
            acceleration_std_m_s2=self.acceleration_std_m_s2,
            probability=self.probability,
        )


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
    moving: list[MovingTable] = Field(default=[], max_length=50)
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
    return Workspace(table.bounds_m, obstacles, [each.obstacle for each in table.moving])


def _checked_keys(workspace: Workspace) -> dict[str, Any]:
    """Check obstacles from Python, and return the rest of their workspace's table."""
    for obstacle in (*workspace.obstacles, *workspace.timed):
        check_obstacle(obstacle)
    moving = [_moving_keys(obstacle) for obstacle in workspace.moving]
    return {"bounds_m": workspace.bounds_m, "moving": moving}


WORLD = ReadAs(WorldTable, _workspace_of, Workspace, to_keys=_checked_keys, needs_folder=True)


def check_obstacle(obstacle: Obstacle) -> None:
    """Raise an InputError for an obstacle that no file could have."""
    key = "world.obstacles"
    check_name(obstacle.name)
    if not obstacle.polygon.is_valid or obstacle.polygon.area == 0.0:
        raise InputError(
            f"{obstacle.name} crosses itself or has no area",
            key=key,
            remedy="list the corners in order along the outline",
        )
    if not 0.0 <= obstacle.known_from_s < obstacle.until_s:
        raise InputError(
            f"{obstacle.name} is known from {obstacle.known_from_s!r} s until "
            f"{obstacle.until_s!r} s",
            key=key,
            remedy="give known_from_s from 0 on, and a larger until_s or none",
        )


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
        "moving": [_moving_keys(obstacle) for obstacle in workspace.moving],
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


def _moving_keys(obstacle: MovingObstacle) -> dict[str, Any]:
    table = saved(asdict(obstacle))
    if not obstacle.is_uncertain:
        del table["probability"]
    return table


def _ring(ring: shapely.LinearRing) -> list[list[float]]:
    return shapely.get_coordinates(ring).tolist()
