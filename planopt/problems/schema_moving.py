"""``[[world.moving]]``: an obstacle that moves as predicted."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.problems.tables import Name, Pair, Table
from planopt.world.moving_obstacle import MovingObstacle


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
                "one_of", "needs either start_m and velocity_m_s, or times_s and positions_m"
            )
        if "probability" in self.model_fields_set and not self.obstacle.is_uncertain:
            raise PydanticCustomError(
                "one_of", "has probability, which needs position_std_m or acceleration_std_m_s2"
            )
        if self.times_s is not None and self.positions_m is not None:
            if len(self.times_s) != len(self.positions_m):
                raise PydanticCustomError(
                    "one_of",
                    "has {times} times_s and {places} positions_m, should have as many of both",
                    {"times": len(self.times_s), "places": len(self.positions_m)},
                )
            if any(later <= earlier for earlier, later in pairwise(self.times_s)):
                raise PydanticCustomError("one_of", "has times_s that do not increase")
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
