"""Problem files of the task coverage, and the scene that they describe."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.coverage.control.movers import Partition
from planopt.coverage.density import Density, GaussianMixture, RasterDensity, UniformDensity
from planopt.coverage.events import Sensing
from planopt.coverage.geodesic import Ground
from planopt.coverage.network import Counting, Method
from planopt.errors import InputError
from planopt.keys import SMALLEST, FileName, Metres, Name, Pair, Quad, Table
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.problems.world_tables import ObstacleTable
from planopt.tasks.coverage.demands import DemandTable
from planopt.tasks.coverage.radio import RadioTable
from planopt.tasks.task import TaskFile
from planopt.world.raster import checked_raster
from planopt.world.raster_files import read_raster

START_TRIES = 400
"""Places that are drawn for agents that start at random, and four more for each agent."""

START_SPARE = 0.1
"""Bodies that start at random places are apart by this share of their radius at least."""

PlannerName = Literal["law", "receding"]


class UniformTable(Table):
    """The same weight everywhere."""

    kind: Literal["uniform"]
    weight_per_m2: float = Field(default=1.0, ge=SMALLEST, le=1e9, description="The weight.")

    def density(self, folder: Path) -> Density:
        """Return the density."""
        return UniformDensity(self.weight_per_m2)


class BumpTable(Table):
    """A Gaussian bump."""

    weight: float = Field(ge=0, le=1e12, description="Its mass.")
    mean_m: Pair = Field(description="Its middle [x, y] in metres.")
    std_m: Metres = Field(ge=SMALLEST, description="Its standard deviation in metres.")


class GaussiansTable(Table):
    """A sum of Gaussian bumps and a floor."""

    kind: Literal["gaussians"]
    bumps: list[BumpTable] = Field(min_length=1, max_length=100, description="The bumps.")
    floor_per_m2: float = Field(default=0.0, ge=0, le=1e9, description="Added everywhere.")

    def density(self, folder: Path) -> Density:
        """Return the density."""
        spread = np.array([each.std_m**2 * np.eye(2) for each in self.bumps])
        weights = np.array([each.weight for each in self.bumps])
        means = np.array([each.mean_m for each in self.bumps])
        return GaussianMixture(weights, means, spread, self.floor_per_m2)


class RasterDensityTable(Table):
    """Values on a grid, from a file or in place."""

    kind: Literal["raster"]
    file: FileName | None = Field(
        default=None, description="CSV, npz, NetCDF or GeoTIFF, relative to the problem file."
    )
    variable: str = Field(default="density", description="Its name in the file.")
    x_m: list[Metres] | None = Field(default=None, description="In place: x of cell centres.")
    y_m: list[Metres] | None = Field(default=None, description="In place: y of cell centres.")
    values: list[list[float]] | None = Field(
        default=None, description="In place: a row for each y, from the smallest."
    )

    def density(self, folder: Path) -> RasterDensity:
        """Return the density."""
        if self.file is not None:
            return RasterDensity(read_raster(folder / self.file, self.variable))
        if self.values is None or len({len(row) for row in self.values}) != 1:
            raise InputError(
                "has neither file nor values of rows of one length", key="density.values"
            )
        x, y = (np.array(each or [], dtype=np.float64) for each in (self.x_m, self.y_m))
        return RasterDensity(checked_raster(x, y, np.array(self.values), "density"))


DensityTable = Annotated[
    UniformTable | GaussiansTable | RasterDensityTable, Field(discriminator="kind")
]


class WorldTable(Table):
    """``[world]``: what is covered."""

    bounds_m: Quad | None = Field(
        default=None, description="[x_min, y_min, x_max, y_max] in metres, or outline_m."
    )
    outline_m: list[Pair] | None = Field(
        default=None, min_length=3, description="Corners [x, y] in order, convex or not."
    )
    obstacles: list[ObstacleTable] = Field(default=[], description="The forbidden areas.")
    clearance_m: Metres = Field(
        default=0.0, ge=0, description="What agents keep from obstacles and the border."
    )
    spacing_m: Metres | None = Field(
        default=None, ge=SMALLEST, description="Grid of the cells where there are obstacles."
    )
    sensing_range_m: Metres | None = Field(
        default=None, ge=SMALLEST, description="How far agents sense; convex regions only."
    )

    @model_validator(mode="after")
    def _one_outline(self) -> WorldTable:
        if (self.bounds_m is None) == (self.outline_m is None):
            raise PydanticCustomError("one_of", "needs exactly one of bounds_m and outline_m")
        return self


class PlacesTable(Table):
    """Agents start at given places."""

    kind: Literal["list"]
    places_m: list[Pair] = Field(min_length=1, max_length=20_000, description="Their [x, y].")

    @property
    def number(self) -> int:
        """Return how many agents there are."""
        return len(self.places_m)

    def places(
        self, ground: Ground, generator: np.random.Generator, body_radius_m: float = 0.0
    ) -> NDArray[np.float64]:
        """Return where agents start."""
        return np.array(self.places_m)


class GridTable(Table):
    """Agents start on an even grid."""

    kind: Literal["grid"]
    columns: int = Field(ge=1, le=200, description="Agents along x.")
    rows: int = Field(ge=1, le=200, description="Agents along y.")
    within_m: Quad = Field(description="[x_min, y_min, x_max, y_max]; agents stand inside.")

    @property
    def number(self) -> int:
        """Return how many agents there are."""
        return self.columns * self.rows

    def places(
        self, ground: Ground, generator: np.random.Generator, body_radius_m: float = 0.0
    ) -> NDArray[np.float64]:
        """Return where agents start."""
        x0, y0, x1, y1 = self.within_m
        x = x0 + (x1 - x0) * (np.arange(self.columns) + 0.5) / self.columns
        y = y0 + (y1 - y0) * (np.arange(self.rows) + 0.5) / self.rows
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


class RandomTable(Table):
    """Agents start at places drawn from the random seed."""

    kind: Literal["random"]
    count: int = Field(ge=1, le=20_000, description="How many agents.")
    within_m: Quad | None = Field(
        default=None, description="[x_min, y_min, x_max, y_max]; left out: the whole region."
    )

    @property
    def number(self) -> int:
        """Return how many agents there are."""
        return self.count

    def places(
        self, ground: Ground, generator: np.random.Generator, body_radius_m: float = 0.0
    ) -> NDArray[np.float64]:
        """Return where agents start."""
        corners = ground.hull.corners_m
        low, high = corners.min(axis=0), corners.max(axis=0)
        if self.within_m is not None:
            low, high = np.array(self.within_m[:2]), np.array(self.within_m[2:])
        drawn = low + (high - low) * generator.random((START_TRIES + 4 * self.count, 2))
        found = drawn[has_room(ground, drawn, body_radius_m)]
        if body_radius_m > 0.0:
            found = found[_spread(found, (2.0 + START_SPARE) * body_radius_m, self.count)]
        found = found[: self.count]
        if len(found) < self.count:
            raise InputError(
                f"only {len(found)} of {self.count} agents found a free place",
                key="agents.start.within_m",
                remedy="give a larger free area"
                + (", or smaller bodies" if body_radius_m > 0.0 else ""),
            )
        return found


def has_room(
    ground: Ground, places_m: NDArray[np.float64], body_radius_m: float
) -> NDArray[np.bool_]:
    """Return whether bodies at places ``(k, 2)`` are within the ground; (k,).

    A geodesic ground keeps the clearance of bodies itself, a convex one has its border alone.
    """
    inside = ground.allows(places_m)
    if body_radius_m == 0.0:
        return inside
    return inside & (ground.hull.excess_m(places_m) <= 1e-9 - body_radius_m)


def _spread(places_m: NDArray[np.float64], apart_m: float, most: int) -> list[int]:
    """The first places, at most so many, of which no two are nearer than `apart_m`."""
    chosen: list[int] = []
    for number, place in enumerate(places_m):
        if len(chosen) == most:
            break
        if (((places_m[chosen] - place) ** 2).sum(axis=1) >= apart_m**2).all():
            chosen.append(number)
    return chosen


class AgentsTable(Table):
    """``[agents]``: who covers."""

    start: Annotated[PlacesTable | GridTable | RandomTable, Field(discriminator="kind")] = Field(
        description="Where they start: a table with kind, list, grid or random."
    )
    speed_max_m_s: float | None = Field(
        default=None, ge=SMALLEST, le=1e4, description="Largest speed in m/s; left out: none."
    )
    body_radius_m: Metres = Field(
        default=0.0,
        ge=0,
        description="Radius of the bodies, which never touch, for the planner receding; 0: points.",
    )
    acceleration_max_m_s2: float | None = Field(
        default=None,
        ge=SMALLEST,
        le=1e6,
        description="Of double integrators, for the planner receding; left out: turns at will.",
    )
    turn_rate_max_rad_s: float | None = Field(
        default=None,
        ge=SMALLEST,
        le=1e3,
        description="Of unicycles, for the planner receding; left out: turns at will.",
    )


class ChangeTable(Table):
    """``[[changes]]``: agents that join late or leave."""

    agents: list[int] = Field(min_length=1, description="Their numbers, from 0.")
    joins_s: float = Field(default=0.0, ge=0, le=1e9, description="They join at this time.")
    leaves_s: float | None = Field(default=None, ge=0, le=1e9, description="They leave at it.")


class EventTable(Table):
    """``[[events]]``: what appears."""

    name: Name = Field(default="event", description="What outputs call it.")
    place_m: Pair = Field(description="Where it appears: [x, y] in metres.")
    velocity_m_s: Pair = Field(default=(0.0, 0.0), description="It moves with this velocity.")
    appears_s: float = Field(default=0.0, ge=0, le=1e9, description="When it appears.")
    ends_s: float | None = Field(default=None, ge=0, le=1e9, description="When it ends.")
    demand: DemandTable = Field(description="How many agents it asks for: a table with kind.")


class SensorTable(Table):
    """``[sensor]``: what agents measure of an event, K / ((d / scale)^2 + 1) and noise."""

    strength: float = Field(ge=SMALLEST, le=1e12, description="K, the signal at the event.")
    noise_std: float = Field(ge=1e-12, le=1e12, description="Standard deviation of the noise.")
    scale_m: Metres = Field(default=1.0, ge=SMALLEST, description="Half the signal is left here.")
    strength_known: bool = Field(default=True, description="Whether agents know K.")
    detection_std: float = Field(
        default=Sensing.detection_std, ge=1, le=100, description="A reading of more is an event."
    )
    silent_steps: int = Field(
        default=Sensing.silent_steps, ge=1, le=1000, description="After so many it has ended."
    )
    memory_s: float | None = Field(
        default=None, ge=SMALLEST, description="Older readings are forgotten; left out: none, or "
        "ten steps if an event moves.",
    )  # fmt: skip
    event_speed_std_m_s: float = Field(
        default=1.0,
        ge=SMALLEST,
        le=1e4,
        description="If an event moves: standard deviation of each component of the velocities of "
        "events before agents measure them.",
    )


class AssignmentTable(Table):
    """``[assignment]``: who responds."""

    hysteresis_m: Metres = Field(default=1.0, ge=0, description="Gain that an exchange needs.")
    moved_m: Metres = Field(
        default=1.0, ge=0, description="It is made anew when an estimate has moved by more."
    )
    stand_off: bool = Field(
        default=False, description="Agents stand on the ring of most information about an event."
    )
    flag_rounds: int = Field(
        default=30, ge=1, le=10_000, description="Rounds of messages in a step, over lossy links."
    )


class CountingTable(Table):
    """``[counting]``: how agents know their number."""

    method: Method = Field(
        default="known",
        description="known, leader (average consensus), minima (of random numbers) or running.",
    )
    rounds: int = Field(default=Counting.rounds, ge=1, le=10**5, description="In a step.")
    epoch_rounds: int = Field(
        default=Counting.epoch_rounds, ge=1, le=10**6, description="Of a count from its start."
    )
    draws: int = Field(default=Counting.draws, ge=3, le=10**5, description="For minima.")
    innovation: float = Field(
        default=Counting.innovation, gt=0, le=1, description="Of the running count."
    )


class LinksTable(Table):
    """``[links]``: loss of messages between agents by distance."""

    k_pl_db: float = Field(ge=-300, le=300, description="Received power at 1 m in dBm.")
    n_pl: float = Field(ge=0.1, le=10, description="Path loss exponent.")
    fading_std_db: float = Field(ge=SMALLEST, le=100, description="Standard deviation in dB.")
    threshold_dbm: float = Field(ge=-500, le=300, description="Weaker messages are lost.")


class ControlTable(Table):
    """``[control]``: how agents move, and for how long."""

    time_step_s: float = Field(default=1.0, ge=SMALLEST, le=1e4, description="Of a step.")
    duration_s: float = Field(ge=SMALLEST, le=1e8, description="The run takes at most this.")
    event_gain_per_s: float = Field(default=0.5, ge=SMALLEST, le=1e6, description="k_1.")
    coverage_gain_per_s: float = Field(default=0.5, ge=SMALLEST, le=1e6, description="k_2.")
    partition: Partition = Field(
        default="all", description="Cells of all agents, or coverage_only: of those that cover."
    )
    settled_m: Metres | None = Field(
        default=None, ge=SMALLEST, description="So near to its target an agent has settled."
    )
    stop_when_settled: bool = Field(
        default=True, description="Whether the run ends when all have settled for good."
    )


class PlannerTable(Table):
    """``[planner]``: who decides the moves."""

    name: PlannerName = Field(
        default="law",
        description="law (the control laws, speeds clipped) or receding (plans ahead).",
    )
    horizon: int = Field(default=1, ge=MIN_HORIZON, le=MAX_HORIZON, description="Steps ahead.")
    lead_events: bool = Field(
        default=False,
        description="Whether receding follows the estimated velocity of an event over the horizon.",
    )


class CoverageFile(TaskFile):
    """A planopt problem file (TOML) of the task coverage."""

    world: WorldTable
    density: DensityTable = Field(default=UniformTable(kind="uniform"), description="Weights.")
    agents: AgentsTable
    changes: list[ChangeTable] = Field(default=[], max_length=1000, description="Of agents.")
    events: list[EventTable] = Field(default=[], max_length=50, description="What appears.")
    sensor: SensorTable | None = None
    assignment: AssignmentTable = Field(default_factory=AssignmentTable)
    counting: CountingTable = Field(default_factory=CountingTable)
    links: LinksTable | None = None
    radio: RadioTable | None = None
    control: ControlTable
    planner: PlannerTable = Field(default_factory=PlannerTable)
