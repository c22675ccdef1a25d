"""Problem-file tables of the task coverage, and the densities and demands that they describe."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.coverage.assignment import (
    Demand,
    accuracy_demand,
    capped_demand,
    table_demand,
    trade_off_demand,
)
from planopt.coverage.control.movers import Gains, Partition
from planopt.coverage.density import Density, GaussianMixture, RasterDensity, UniformDensity
from planopt.coverage.events import Sensing
from planopt.coverage.limits import MoveLimits
from planopt.coverage.network import Counting, LinkModel
from planopt.errors import InputError
from planopt.keys import SMALLEST, Distance, FileName, Length, Metres, Name, Pair, Quad, Table
from planopt.problems.schema import Obstacles, TaskFile
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.world.raster import checked_raster
from planopt.world.raster_files import read_raster

PlannerName = Literal["law", "receding", "deploy"]


class UniformTable(Table):
    """Uniform density."""

    kind: Literal["uniform"]
    weight_per_m2: float = Field(default=1.0, ge=SMALLEST, le=1e9)
    """Weight per square metre."""


class BumpTable(Table):
    """Gaussian bump."""

    weight: float = Field(ge=0, le=1e12)
    """Mass of the bump over the whole plane."""
    mean_m: Pair
    """Centre [x, y] in metres."""
    std_m: Length
    """Standard deviation in metres."""


class GaussiansTable(Table):
    """Sum of Gaussian bumps and a uniform density."""

    kind: Literal["gaussians"]
    bumps: list[BumpTable] = Field(min_length=1, max_length=100)
    """Gaussian bumps."""
    floor_per_m2: float = Field(default=0.0, ge=0, le=1e9)
    """Uniform density added to the bumps."""


class RasterDensityTable(Table):
    """Density on a grid, from a file or inline."""

    kind: Literal["raster"]
    file: FileName | None = None
    """CSV, npz, NetCDF or GeoTIFF, relative to the problem file."""
    variable: str = "density"
    """Name of the density variable in the file."""
    x_m: list[Metres] | None = None
    """Inline grid: x of the cell centres in metres."""
    y_m: list[Metres] | None = None
    """Inline grid: y of the cell centres in metres."""
    values: list[list[float]] | None = None
    """Inline grid: one row of values for each y, from the smallest y."""


DensityTable = Annotated[
    UniformTable | GaussiansTable | RasterDensityTable, Field(discriminator="kind")
]


class WorldTable(Table):
    """Table ``[world]``: the covered region."""

    bounds_m: Quad | None = None
    """Rectangle [x_min, y_min, x_max, y_max] in metres; alternative to outline_m."""
    outline_m: list[Pair] | None = Field(default=None, min_length=3)
    """Corners [x, y] of a polygon in order, convex or not."""
    obstacles: Obstacles = ()
    """Forbidden areas."""
    clearance_m: Distance = 0.0
    """Distance in metres that agents keep from obstacles and the outer boundary."""
    spacing_m: Length | None = None
    """Grid spacing of geodesic cells in metres; for non-convex regions or obstacles."""
    sensing_range_m: Length | None = None
    """Sensing range of agents in metres; only for convex regions without obstacles."""

    @model_validator(mode="after")
    def _one_outline(self) -> WorldTable:
        if (self.bounds_m is None) == (self.outline_m is None):
            raise PydanticCustomError("one_of", "needs exactly one of bounds_m and outline_m")
        return self


class PlacesTable(Table):
    """Listed starting positions."""

    kind: Literal["list"]
    places_m: list[Pair] = Field(min_length=1, max_length=20_000)
    """Starting positions [x, y] in metres."""

    @property
    def number(self) -> int:
        """Return the number of agents."""
        return len(self.places_m)


class GridTable(Table):
    """Starting positions on a regular grid."""

    kind: Literal["grid"]
    columns: int = Field(ge=1, le=200)
    """Number of agents along x."""
    rows: int = Field(ge=1, le=200)
    """Number of agents along y."""
    within_m: Quad
    """Rectangle [x_min, y_min, x_max, y_max] in metres that the grid fills."""

    @property
    def number(self) -> int:
        """Return the number of agents."""
        return self.columns * self.rows


class RandomTable(Table):
    """Starting positions drawn with the random seed."""

    kind: Literal["random"]
    count: int = Field(ge=1, le=20_000)
    """Number of agents."""
    within_m: Quad | None = None
    """Rectangle [x_min, y_min, x_max, y_max] in metres; default: the whole region."""

    @property
    def number(self) -> int:
        """Return the number of agents."""
        return self.count


class NumberTable(Table):
    """Demand for a fixed number of agents."""

    kind: Literal["number"]
    agents: int = Field(ge=0, le=20_000)
    """Number of agents that respond."""


class StepTable(Table):
    """Entry of a tabulated demand."""

    at_least: int = Field(ge=0, le=20_000)
    """Minimum number of agents in the network for which the entry applies."""
    respond: int = Field(ge=0, le=20_000)
    """Number of agents that respond."""


class TableDemandTable(Table):
    """Demand tabulated by the number of agents in the network."""

    kind: Literal["table"]
    steps: list[StepTable] = Field(min_length=1)
    """Entries of the table."""


class CapTable(Table):
    """Demand for a share of the agents, with an upper limit and a reserve of covering agents."""

    kind: Literal["cap"]
    share: float = Field(ge=0, le=1)
    """Share of all agents, rounded up."""
    most: int = Field(ge=0, le=20_000)
    """Maximum number of agents that respond."""
    remaining: int = Field(default=1, ge=0, le=20_000)
    """Minimum number of agents that continue to cover."""


class AccuracyTable(Table):
    """Demand for the smallest team that locates the event with the required accuracy."""

    kind: Literal["accuracy"]
    accuracy_m: Length
    """Required root mean squared position error in metres."""
    measurements: int = Field(default=1, ge=1, le=10**6)
    """Number of measurements by each agent."""


class TradeOffTable(Table):
    """Demand that trades coverage cost against localisation error."""

    kind: Literal["trade_off"]
    localisation_m2: float = Field(ge=SMALLEST, le=1e12)
    """Mean squared localisation error of one agent in m^2."""
    coverage_weight: float = Field(default=1.0, ge=SMALLEST, le=1e12)
    """Weight of the coverage cost H."""
    localisation_weight: float = Field(ge=SMALLEST, le=1e15)
    """Weight of the localisation error."""


DemandTable = Annotated[
    NumberTable | TableDemandTable | CapTable | AccuracyTable | TradeOffTable,
    Field(discriminator="kind"),
]


class AgentsTable(Table):
    """Table ``[agents]``: starting positions and motion limits."""

    start: Annotated[PlacesTable | GridTable | RandomTable, Field(discriminator="kind")]
    """Starting positions: a table with kind, list, grid or random."""
    speed_max_m_s: float | None = Field(default=None, ge=SMALLEST, le=1e4)
    """Largest speed in m/s; default: no limit."""
    body_radius_m: Distance = 0.0
    """Radius of the bodies in metres; bodies never touch (planner receding); 0: points."""
    acceleration_max_m_s2: float | None = Field(default=None, ge=SMALLEST, le=1e6)
    """Acceleration limit in m/s^2 of double integrators (planner receding); default: no limit."""
    turn_rate_max_rad_s: float | None = Field(default=None, ge=SMALLEST, le=1e3)
    """Turn rate limit in rad/s of unicycles (planner receding); default: no limit."""


class ChangeTable(Table):
    """Table ``[[changes]]``: agents that join late or leave."""

    agents: list[int] = Field(min_length=1)
    """Numbers of the agents, from 0."""
    joins_s: float = Field(default=0.0, ge=0, le=1e9)
    """Time in seconds at which the agents join."""
    leaves_s: float | None = Field(default=None, ge=0, le=1e9)
    """Time in seconds at which the agents leave; default: never."""


class EventTable(Table):
    """Table ``[[events]]``: an event that appears in the region."""

    name: Name = "event"
    """Name in outputs."""
    place_m: Pair
    """Position [x, y] in metres at the time of appearance."""
    velocity_m_s: Pair = (0.0, 0.0)
    """Velocity [vx, vy] in m/s."""
    appears_s: float = Field(default=0.0, ge=0, le=1e9)
    """Time of appearance in seconds."""
    ends_s: float | None = Field(default=None, ge=0, le=1e9)
    """Time of the end in seconds; default: never."""
    demand: DemandTable
    """Number of agents that the event requires: a table with kind."""


class SensorTable(Table):
    """Table ``[sensor]``: signal K / ((d / scale)^2 + 1) of an event, and noise."""

    strength: float = Field(ge=SMALLEST, le=1e12)
    """Signal K at the event."""
    noise_std: float = Field(ge=1e-12, le=1e12)
    """Standard deviation of the noise, in the unit of K."""
    scale_m: Length = 1.0
    """Distance in metres at which the signal has half its strength."""
    strength_known: bool = True
    """True if agents know K; otherwise they estimate it."""
    detection_std: float = Field(default=Sensing.detection_std, ge=1, le=100)
    """Detection threshold in standard deviations of the noise."""
    silent_steps: int = Field(default=Sensing.silent_steps, ge=1, le=1000)
    """Number of steps without detection after which an event has ended."""
    memory_s: float | None = Field(default=None, ge=SMALLEST)
    """Age limit of readings in seconds; default: no limit, or ten steps if an event moves."""
    event_speed_std_m_s: float = Field(default=1.0, ge=SMALLEST, le=1e4)
    """Prior standard deviation in m/s of each velocity component of events; used if an event
    moves."""


class AssignmentTable(Table):
    """Table ``[assignment]``: rules of the assignment of agents to events."""

    hysteresis_m: Distance = 1.0
    """Advantage in distance, in metres, beyond which a new agent replaces an assigned one."""
    stand_off: bool = False
    """True if responding agents take positions on the most informative ring around an event."""
    flag_rounds: int = Field(default=30, ge=1, le=10_000)
    """Maximum number of message rounds per step for each flood of readings, estimates and lists,
    if links lose messages."""


class SurveyTable(Table):
    """Table ``[[radio.survey]]``: power measurements of a station: a log, inline or simulated."""

    file: FileName | None = None
    """CSV with x_m, y_m and power_dbm, relative to the problem file."""
    places_m: list[Pair] | None = Field(default=None, min_length=1)
    """Inline: positions [x, y] in metres."""
    power_dbm: list[float] | None = None
    """Inline: powers in dBm."""
    floor_dbm: float | None = Field(default=None, ge=-500, le=300)
    """Receiver floor in dBm; powers at or below it are censored."""
    count: int | None = Field(default=None, ge=10, le=2000)
    """Simulated: number of measurements at random positions of a channel drawn with radio.k_pl_db,
    radio.n_pl and the parameters below."""
    shadow_std_db: float = Field(default=6.0, ge=0, le=50)
    """Simulated: standard deviation of shadowing in dB."""
    decorrelation_m: float = Field(default=25.0, ge=0.1, le=1e9)
    """Simulated: decorrelation distance of shadowing in metres."""
    multipath_std_db: float = Field(default=1.0, ge=0, le=50)
    """Simulated: standard deviation of multipath in dB."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Simulated: random seed."""

    @model_validator(mode="after")
    def _one_source(self) -> SurveyTable:
        in_place = self.places_m is not None or self.power_dbm is not None
        if sum((self.file is not None, in_place, self.count is not None)) != 1:
            raise PydanticCustomError(
                "one_of", "needs exactly one of file, places_m with power_dbm, and count"
            )
        if in_place and len(self.places_m or ()) != len(self.power_dbm or ()):
            raise PydanticCustomError("one_of", "needs one power_dbm for each of places_m")
        return self


class RadioTable(Table):
    """Table ``[radio]``: required connection to base stations, directly or via other agents."""

    stations_m: list[Pair] = Field(min_length=1, max_length=100)
    """Positions [x, y] of the base stations in metres."""
    p_min: float = Field(gt=0, lt=1)
    """Required probability that each agent has a connected path to a station."""
    k_pl_db: float = Field(ge=-300, le=300)
    """Received power at 1 m in dBm."""
    n_pl: float = Field(ge=0.1, le=10)
    """Path loss exponent."""
    deviation_db: float = Field(ge=0, le=100)
    """Standard deviation of shadowing and multipath together, in dB."""
    k_pl_std_db: float = Field(default=0.0, ge=0, le=100)
    """Standard deviation of k_pl_db in dB."""
    n_pl_std: float = Field(default=0.0, ge=0, le=10)
    """Standard deviation of n_pl."""
    threshold_dbm: float = Field(ge=-500, le=300)
    """Power in dBm required for a link."""
    survey: list[SurveyTable] = Field(default=[])
    """Surveys, one for each station: links to stations use the channels estimated from them; links
    between agents use the path loss law above."""


class ControlTable(Table):
    """Table ``[control]``: time step, gains, and end of a run."""

    time_step_s: float = Field(default=1.0, ge=SMALLEST, le=1e4)
    """Duration of a step in seconds."""
    duration_s: float = Field(ge=SMALLEST, le=1e8)
    """Maximum duration of a run in seconds."""
    event_gain_per_s: float = Field(default=0.5, ge=SMALLEST, le=1e6)
    """Gain k_1 of agents that respond to an event, in 1/s."""
    coverage_gain_per_s: float = Field(default=0.5, ge=SMALLEST, le=1e6)
    """Gain k_2 of covering agents, in 1/s."""
    partition: Partition = "all"
    """Agents that get a cell of the region: all, or coverage_only (only covering agents)."""
    settled_m: Length | None = None
    """Distance to its target in metres up to which an agent counts as settled."""
    stop_when_settled: bool = True
    """True if the run ends once all agents are settled permanently."""

    @property
    def gains(self) -> Gains:
        """Return the gains of the control laws."""
        return Gains(self.event_gain_per_s, self.coverage_gain_per_s)


class PlannerTable(Table):
    """Table ``[planner]``: control law or planner of the agents."""

    name: PlannerName = "law"
    """Planner: law (control laws with clipped speed), receding (receding horizon), or deploy
    (receding horizon to the deployment that solve finds)."""
    horizon: int = Field(default=1, ge=MIN_HORIZON, le=MAX_HORIZON)
    """Horizon in steps."""
    lead_events: bool = False
    """True if the planner receding predicts the motion of an event over the horizon."""


class CoverageFile(TaskFile):
    """Problem file (TOML) of the task coverage."""

    world: WorldTable
    density: DensityTable = UniformTable(kind="uniform")
    """Density over the region: a table with kind."""
    agents: AgentsTable
    changes: list[ChangeTable] = Field(default=[], max_length=1000)
    """Agents that join late or leave."""
    events: list[EventTable] = Field(default=[], max_length=50)
    """Events that appear in the region."""
    sensor: SensorTable | None = None
    assignment: AssignmentTable = Field(default_factory=AssignmentTable)
    counting: Counting = Field(default_factory=Counting)
    links: LinkModel | None = None
    radio: RadioTable | None = None
    control: ControlTable
    planner: PlannerTable = Field(default_factory=PlannerTable)

    @property
    def limits(self) -> MoveLimits:
        """Return the motion limits and clearances of the agents."""
        agents = self.agents
        return MoveLimits(
            self.control.time_step_s,
            math.inf if agents.speed_max_m_s is None else agents.speed_max_m_s,
            agents.acceleration_max_m_s2,
            agents.turn_rate_max_rad_s,
            body_radius_m=agents.body_radius_m,
            clearance_m=self.world.clearance_m,
        )


def density_of(table: DensityTable, folder: Path) -> Density:
    """Return the density that a table describes; its file is relative to `folder`."""
    if isinstance(table, UniformTable):
        return UniformDensity(table.weight_per_m2)
    if isinstance(table, GaussiansTable):
        stds = np.array([each.std_m for each in table.bumps])
        weights = np.array([each.weight for each in table.bumps])
        means = np.array([each.mean_m for each in table.bumps])
        return GaussianMixture(weights, means, stds, table.floor_per_m2)
    if table.file is not None:
        return RasterDensity(read_raster(folder / table.file, table.variable))
    if table.values is None or len({len(row) for row in table.values}) != 1:
        raise InputError(
            "is needed if there is no file, and all its rows must have the same length",
            key="density.values",
        )
    x, y = (np.array(each or [], dtype=np.float64) for each in (table.x_m, table.y_m))
    return RasterDensity(checked_raster(x, y, np.array(table.values), "density"))


def demand_of(
    table: DemandTable, key: str, sensing: Sensing, area_m2: float, agents: int
) -> Demand:
    """Return the demand that a table describes; raise `InputError` if agents cannot meet it."""
    if isinstance(table, NumberTable):
        if table.agents > agents:
            raise InputError(
                f"is {table.agents}, more than the number of agents ({agents})",
                key=f"{key}.agents",
                remedy="add agents, or require fewer",
            )
        return lambda count: min(table.agents, count)
    if isinstance(table, TableDemandTable):
        for number, step in enumerate(table.steps):
            if step.respond > step.at_least:
                raise InputError(
                    f"is {step.respond}, more than at_least = {step.at_least}",
                    key=f"{key}.steps[{number}].respond",
                    remedy="give at most at_least",
                )
        return table_demand({each.at_least: each.respond for each in table.steps})
    if isinstance(table, CapTable):
        if table.remaining >= agents:
            raise InputError(
                f"is {table.remaining}, which leaves none of the {agents} agents to respond",
                key=f"{key}.remaining",
                remedy="add agents, or reduce it",
            )
        return capped_demand(table.share, table.most, table.remaining)
    if isinstance(table, AccuracyTable):
        demand = accuracy_demand(
            sensing.sensor, table.accuracy_m, table.measurements, sensing.strength_known
        )
        if demand(10**9) > agents:
            raise InputError(
                f"needs {demand(10**9)} agents, but there are {agents}",
                key=f"{key}.accuracy_m",
                remedy="add agents, or allow a larger error",
            )
        return demand
    return trade_off_demand(
        area_m2, table.localisation_m2, table.coverage_weight, table.localisation_weight
    )
