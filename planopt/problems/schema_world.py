"""``[world]``: the workspace, its obstacles, and those that move."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.problems.tables import FileName, Name, Pair, Quad, Table
from planopt.world.moving_obstacle import MovingObstacle
from planopt.world.occupancy_files import is_grid
from planopt.world.occupancy_grid import UnknownCells
from planopt.world.workspace import Obstacle


class MovingTable(Table):
    """One disc: ``start_m`` and ``velocity_m_s``, or ``times_s`` and ``positions_m``."""

    name: Name = Field(description="What messages and pictures call it.")
    radius_m: float = Field(
        gt=0,
        le=1e4,
        description="Radius of the disc in metres; constraints.clearance_m is kept from it.",
    )
    start_m: Pair | None = Field(
        default=None, description="Centre [x, y] in metres at time 0, when planning begins."
    )
    velocity_m_s: Pair | None = Field(
        default=None,
        description="Velocity [x, y] in m/s, from start_m on or after the last of times_s; without "
        "it there, the disc stands.",
    )
    times_s: list[Annotated[float, Field(ge=0, le=1e7)]] | None = Field(
        default=None,
        min_length=1,
        description="Times in seconds, increasing, at which the centre is at positions_m; it "
        "stands before the first.",
    )
    positions_m: list[Pair] | None = Field(
        default=None, min_length=1, description="Centres [x, y] in metres at times_s."
    )
    position_std_m: float = Field(
        default=0.0,
        ge=0,
        le=1e4,
        description="Standard deviation in metres, along each axis, of the predicted centre.",
    )
    acceleration_std_m_s2: float = Field(
        default=0.0,
        ge=0,
        le=1e3,
        description="Standard deviation in m/s^2, along each axis, of an acceleration that is not "
        "predicted; the centre's error grows with the time ahead.",
    )
    probability: float = Field(
        default=MovingObstacle.probability,
        gt=0,
        lt=1,
        description="Least probability, for each step, that the centre keeps within what the "
        "radius is grown by for these deviations.",
    )

    @model_validator(mode="after")
    def _one_motion(self) -> MovingTable:
        straight = self.start_m is not None and self.velocity_m_s is not None
        timed = self.times_s is not None and self.positions_m is not None
        given = sum(each is not None for each in (self.start_m, self.times_s, self.positions_m))
        if not (straight and given == 1) and not (timed and given == 2):
            raise PydanticCustomError(
                "one_of",
                "needs either start_m and velocity_m_s, or times_s and positions_m: leave the "
                "others out",
            )
        if "probability" in self.model_fields_set and not self.obstacle.is_uncertain:
            raise PydanticCustomError(
                "one_of",
                "has probability, which needs position_std_m or acceleration_std_m_s2: write "
                "position_std_m = 0.5, or leave probability out",
            )
        if self.times_s is not None and self.positions_m is not None:
            if len(self.times_s) != len(self.positions_m):
                raise PydanticCustomError(
                    "one_of",
                    "has {times} times_s and {places} positions_m: give a place for each time",
                    {"times": len(self.times_s), "places": len(self.positions_m)},
                )
            if any(later <= earlier for earlier, later in pairwise(self.times_s)):
                raise PydanticCustomError("one_of", "has times_s that do not increase: sort them")
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

    name: str | None = Field(
        default=None,
        description="What messages call it, for polygon and wkt; a file's obstacles have names.",
    )
    file: FileName | None = Field(
        default=None,
        description="GeoJSON (.geojson), WKT (.wkt), building file (.json) or occupancy grid "
        "(.yaml as in ROS, .csv), in metres, relative to the problem file.",
    )
    unknown: UnknownCells = Field(
        default="occupied",
        description="What unknown cells of an occupancy grid are taken for: occupied or free.",
    )
    polygon: list[Pair] | None = Field(
        default=None, min_length=3, description="Outer ring, a list of [x, y] in metres."
    )
    holes: list[Annotated[list[Pair], Field(min_length=3)]] = Field(
        default=[], description="Rings of holes in polygon, each a list of [x, y] in metres."
    )
    wkt: str | None = Field(default=None, min_length=1, description="A POLYGON in metres.")
    known_from_s: float = Field(
        default=Obstacle.known_from_s,
        ge=0,
        le=1e9,
        description="Time of the run in seconds from which on it stands there; no plan made before "
        "knows of it.",
    )
    until_s: float | None = Field(
        default=None,
        gt=0,
        le=1e9,
        description="Time in seconds from which on it is gone, which nobody knows before; without "
        "it, it stays.",
    )

    @model_validator(mode="after")
    def _one_source(self) -> ObstacleTable:
        given = [key for key in ("file", "polygon", "wkt") if getattr(self, key) is not None]
        if len(given) != 1:
            raise PydanticCustomError(
                "one_of",
                "needs exactly one of file, polygon and wkt, has {given}: write "
                "polygon = [[x, y], ...] in metres, for instance",
                {"given": " and ".join(given) or "none"},
            )
        if self.holes and self.polygon is None:
            raise PydanticCustomError(
                "one_of", "has holes, which go only with polygon: a file and wkt have their own"
            )
        if "unknown" in self.model_fields_set and not is_grid(self.file):
            raise PydanticCustomError(
                "one_of",
                "has unknown, which goes only with the file of an occupancy grid: leave it out",
            )
        if self.until_s is not None and self.until_s <= self.known_from_s:
            raise PydanticCustomError(
                "one_of", "has until_s that is not after known_from_s: give a later one, or none"
            )
        if self.name is not None and self.file is not None:
            raise PydanticCustomError(
                "one_of",
                "has a name, which goes only with polygon and wkt, beside file: leave it out, "
                "since a file has names of its own",
            )
        return self


class WorldTable(Table):
    """``[world]``: where robots may be."""

    bounds_m: Quad = Field(description="[x_min, y_min, x_max, y_max] in metres.")
    obstacles: list[ObstacleTable] = Field(default=[], description="The forbidden areas.")
    moving: list[MovingTable] = Field(
        default=[], max_length=50, description="Obstacles that move as predicted."
    )
