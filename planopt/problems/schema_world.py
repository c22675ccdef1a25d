"""``[world]``: where robots may be, and what stands or moves there."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.problems.schema_moving import MovingTable
from planopt.problems.tables import FileName, Pair, Quad, Table
from planopt.world.occupancy_files import is_grid
from planopt.world.occupancy_grid import UnknownCells
from planopt.world.workspace import Obstacle


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
                "needs exactly one of file, polygon and wkt, has {given}",
                {"given": " and ".join(given) or "none"},
            )
        if self.holes and self.polygon is None:
            raise PydanticCustomError("one_of", "has holes, which go only with polygon")
        if "unknown" in self.model_fields_set and not is_grid(self.file):
            raise PydanticCustomError(
                "one_of", "has unknown, which goes only with the file of an occupancy grid"
            )
        if self.until_s is not None and self.until_s <= self.known_from_s:
            raise PydanticCustomError("one_of", "has until_s that is not after known_from_s")
        if self.name is not None and self.file is not None:
            raise PydanticCustomError(
                "one_of", "has a name, which goes only with polygon and wkt, beside file"
            )
        return self


class WorldTable(Table):
    """``[world]``: where robots may be."""

    bounds_m: Quad = Field(description="[x_min, y_min, x_max, y_max] in metres.")
    obstacles: list[ObstacleTable] = Field(default=[], description="The forbidden areas.")
    moving: list[MovingTable] = Field(
        default=[], max_length=50, description="Obstacles that move as predicted."
    )
