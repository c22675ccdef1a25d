"""Tables of problem files of the task coverage."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.coverage.control.movers import Gains, Partition
from planopt.coverage.events import Sensing
from planopt.coverage.network import Counting, LinkModel
from planopt.keys import SMALLEST, Distance, FileName, Length, Metres, Name, Pair, Quad, Table
from planopt.problems.schema import ObstacleTable
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.tasks.task import TaskFile

PlannerName = Literal["law", "receding"]


class UniformTable(Table):
    """The same weight everywhere."""

    kind: Literal["uniform"]
    weight_per_m2: float = Field(default=1.0, ge=SMALLEST, le=1e9)
    """The weight."""


class BumpTable(Table):
    """A Gaussian bump."""

    weight: float = Field(ge=0, le=1e12)
    """Its mass."""
    mean_m: Pair
    """Its middle [x, y] in metres."""
    std_m: Length
    """Its standard deviation in metres."""


class GaussiansTable(Table):
    """A sum of Gaussian bumps and a floor."""

    kind: Literal["gaussians"]
    bumps: list[BumpTable] = Field(min_length=1, max_length=100)
    """The bumps."""
    floor_per_m2: float = Field(default=0.0, ge=0, le=1e9)
    """Added everywhere."""


class RasterDensityTable(Table):
    """Values on a grid, from a file or in place."""

    kind: Literal["raster"]
    file: FileName | None = None
    """CSV, npz, NetCDF or GeoTIFF, relative to the problem file."""
    variable: str = "density"
    """Its name in the file."""
    x_m: list[Metres] | None = None
    """In place: x of cell centres."""
    y_m: list[Metres] | None = None
    """In place: y of cell centres."""
    values: list[list[float]] | None = None
    """In place: a row for each y, from the smallest."""


DensityTable = Annotated[
    UniformTable | GaussiansTable | RasterDensityTable, Field(discriminator="kind")
]


class WorldTable(Table):
    """``[world]``: the covered region."""

    bounds_m: Quad | None = None
    """[x_min, y_min, x_max, y_max] in metres, or outline_m."""
    outline_m: list[Pair] | None = Field(default=None, min_length=3)
    """Corners [x, y] in order, convex or not."""
    obstacles: list[ObstacleTable] = Field(default=[])
    """The forbidden areas."""
    clearance_m: Distance = 0.0
    """Distance that agents keep from obstacles and the border."""
    spacing_m: Length | None = None
    """Grid of the cells; for regions with obstacles."""
    sensing_range_m: Length | None = None
    """Sensing range of agents; for convex regions only."""

    @model_validator(mode="after")
    def _one_outline(self) -> WorldTable:
        if (self.bounds_m is None) == (self.outline_m is None):
            raise PydanticCustomError("one_of", "needs exactly one of bounds_m and outline_m")
        return self


class PlacesTable(Table):
    """Agents start at listed positions."""

    kind: Literal["list"]
    places_m: list[Pair] = Field(min_length=1, max_length=20_000)
    """Their [x, y]."""

    @property
    def number(self) -> int:
        """Return the number of agents."""
        return len(self.places_m)


class GridTable(Table):
    """Agents start on an even grid."""

    kind: Literal["grid"]
    columns: int = Field(ge=1, le=200)
    """Agents along x."""
    rows: int = Field(ge=1, le=200)
    """Agents along y."""
    within_m: Quad
    """[x_min, y_min, x_max, y_max]; agents stand inside."""

    @property
    def number(self) -> int:
        """Return the number of agents."""
        return self.columns * self.rows


class RandomTable(Table):
    """Agents start at positions drawn from the random seed."""

    kind: Literal["random"]
    count: int = Field(ge=1, le=20_000)
    """How many agents."""
    within_m: Quad | None = None
    """[x_min, y_min, x_max, y_max]; left out: the whole region."""

    @property
    def number(self) -> int:
        """Return the number of agents."""
        return self.count


class NumberTable(Table):
    """A fixed number of agents."""

    kind: Literal["number"]
    agents: int = Field(ge=0, le=20_000)
    """How many."""


class StepTable(Table):
    """A step of a demand."""

    at_least: int = Field(ge=0, le=20_000)
    """Least number of agents."""
    respond: int = Field(ge=0, le=20_000)
    """Number that responds."""


class TableDemandTable(Table):
    """The demand by the number of agents, from a table."""

    kind: Literal["table"]
    steps: list[StepTable] = Field(min_length=1)
    """Entries of the table."""


class CapTable(Table):
    """A share of the agents, at most a number, so that enough remain."""

    kind: Literal["cap"]
    share: float = Field(ge=0, le=1)
    """Share of all agents, rounded up."""
    most: int = Field(ge=0, le=20_000)
    """At most so many."""
    remaining: int = Field(default=1, ge=0, le=20_000)
    """Number that goes on covering."""


class AccuracyTable(Table):
    """The fewest agents that locate the event well enough."""

    kind: Literal["accuracy"]
    accuracy_m: Length
    """Root mean squared error in metres."""
    measurements: int = Field(default=1, ge=1, le=10**6)
    """Of each agent."""


class TradeOffTable(Table):
    """The number of agents that balances coverage against localisation."""

    kind: Literal["trade_off"]
    localisation_m2: float = Field(ge=SMALLEST, le=1e12)
    """Error with one agent."""
    coverage_weight: float = Field(default=1.0, ge=SMALLEST, le=1e12)
    """Of H."""
    localisation_weight: float = Field(ge=SMALLEST, le=1e15)
    """Of the error."""


DemandTable = Annotated[
    NumberTable | TableDemandTable | CapTable | AccuracyTable | TradeOffTable,
    Field(discriminator="kind"),
]


class AgentsTable(Table):
    """``[agents]``: starting positions and limits of motion."""

    start: Annotated[PlacesTable | GridTable | RandomTable, Field(discriminator="kind")]
    """Starting positions: a table with kind, list, grid or random."""
    speed_max_m_s: float | None = Field(default=None, ge=SMALLEST, le=1e4)
    """Largest speed in m/s; left out: none."""
    body_radius_m: Distance = 0.0
    """Radius of the bodies, which never touch, for the planner receding; 0: points."""
    acceleration_max_m_s2: float | None = Field(default=None, ge=SMALLEST, le=1e6)
    """Of double integrators, for the planner receding; left out: turns at will."""
    turn_rate_max_rad_s: float | None = Field(default=None, ge=SMALLEST, le=1e3)
    """Of unicycles, for the planner receding; left out: turns at will."""


class ChangeTable(Table):
    """``[[changes]]``: agents that join late or leave."""

    agents: list[int] = Field(min_length=1)
    """Their numbers, from 0."""
    joins_s: float = Field(default=0.0, ge=0, le=1e9)
    """They join at this time."""
    leaves_s: float | None = Field(default=None, ge=0, le=1e9)
    """They leave at it."""


class EventTable(Table):
    """``[[events]]``: an event that appears in the region."""

    name: Name = "event"
    """Name in outputs."""
    place_m: Pair
    """Position where it appears: [x, y] in metres."""
    velocity_m_s: Pair = (0.0, 0.0)
    """Velocity [vx, vy]."""
    appears_s: float = Field(default=0.0, ge=0, le=1e9)
    """When it appears."""
    ends_s: float | None = Field(default=None, ge=0, le=1e9)
    """When it ends."""
    demand: DemandTable
    """Number of agents that it requires: a table with kind."""


class SensorTable(Table):
    """``[sensor]``: signal K / ((d / scale)^2 + 1) of an event, and noise."""

    strength: float = Field(ge=SMALLEST, le=1e12)
    """K, the signal at the event."""
    noise_std: float = Field(ge=1e-12, le=1e12)
    """Standard deviation of the noise."""
    scale_m: Length = 1.0
    """Distance at which half is left."""
    strength_known: bool = True
    """Whether agents know K."""
    detection_std: float = Field(default=Sensing.detection_std, ge=1, le=100)
    """A reading of more is an event."""
    silent_steps: int = Field(default=Sensing.silent_steps, ge=1, le=1000)
    """After so many it has ended."""
    memory_s: float | None = Field(default=None, ge=SMALLEST)
    """Older readings are forgotten; left out: none, or ten steps if an event moves."""
    event_speed_std_m_s: float = Field(default=1.0, ge=SMALLEST, le=1e4)
    """If an event moves: standard deviation of each component of the velocities of events before
    agents measure them."""


class AssignmentTable(Table):
    """``[assignment]``: rules of the assignment of agents to events."""

    hysteresis_m: Distance = 1.0
    """Gain that an exchange needs."""
    moved_m: Distance = 1.0
    """Motion of an estimate that needs a new assignment."""
    stand_off: bool = False
    """Agents stand on the ring of most information about an event."""
    flag_rounds: int = Field(default=30, ge=1, le=10_000)
    """Rounds of messages in a step, over lossy links."""


class SurveyTable(Table):
    """``[[radio.survey]]``: measured power from a station, from a log, in place, or simulated."""

    file: FileName | None = None
    """CSV with x_m, y_m and power_dbm, relative to the problem file."""
    places_m: list[Pair] | None = Field(default=None, min_length=1)
    """In place: where, [x, y]."""
    power_dbm: list[float] | None = None
    """In place: the powers in dBm."""
    floor_dbm: float | None = Field(default=None, ge=-500, le=300)
    """Powers at or below it are upper limits."""
    count: int | None = Field(default=None, ge=10, le=2000)
    """Simulated: measured at so many random places, of a channel drawn with radio.k_pl_db,
    radio.n_pl and the shadowing below."""
    shadow_std_db: float = Field(default=6.0, ge=0, le=50)
    """Simulated: shadowing."""
    decorrelation_m: float = Field(default=25.0, ge=0.1, le=1e9)
    """Simulated: it forgets so."""
    multipath_std_db: float = Field(default=1.0, ge=0, le=50)
    """Simulated: multipath."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Simulated: the random seed."""

    @model_validator(mode="after")
    def _one_source(self) -> SurveyTable:
        in_place = self.places_m is not None or self.power_dbm is not None
        if sum((self.file is not None, in_place, self.count is not None)) != 1:
            raise PydanticCustomError(
                "one_of", "needs exactly one of file, places_m with power_dbm, and count"
            )
        if in_place and len(self.places_m or ()) != len(self.power_dbm or ()):
            raise PydanticCustomError("lengths", "has not one power for each place")
        return self


class RadioTable(Table):
    """``[radio]``: links to base stations that agents keep, directly or over other agents."""

    stations_m: list[Pair] = Field(min_length=1, max_length=100)
    """Base stations."""
    p_min: float = Field(gt=0, lt=1)
    """Probability with which each agent keeps its path to a station."""
    k_pl_db: float = Field(ge=-300, le=300)
    """Received power at 1 m in dBm."""
    n_pl: float = Field(ge=0.1, le=10)
    """Path loss exponent."""
    deviation_db: float = Field(ge=0, le=100)
    """Standard deviation of shadowing and multipath together."""
    k_pl_std_db: float = Field(default=0.0, ge=0, le=100)
    """How uncertain k_pl_db is."""
    n_pl_std: float = Field(default=0.0, ge=0, le=10)
    """How uncertain n_pl is."""
    threshold_dbm: float = Field(ge=-500, le=300)
    """Power that a link needs."""
    survey: list[SurveyTable] = Field(default=[])
    """For each station what was measured of it: links to stations are those of the channel that is
    learnt from it, links between agents keep to the law above."""


class ControlTable(Table):
    """``[control]``: time steps, gains, and the end of a run."""

    time_step_s: float = Field(default=1.0, ge=SMALLEST, le=1e4)
    """Of a step."""
    duration_s: float = Field(ge=SMALLEST, le=1e8)
    """The run takes at most this."""
    event_gain_per_s: float = Field(default=0.5, ge=SMALLEST, le=1e6)
    """k_1."""
    coverage_gain_per_s: float = Field(default=0.5, ge=SMALLEST, le=1e6)
    """k_2."""
    partition: Partition = "all"
    """Cells of all agents, or coverage_only: of those that cover."""
    settled_m: Length | None = None
    """Distance to a target at which an agent has settled."""
    stop_when_settled: bool = True
    """Whether the run ends when all have settled for good."""

    @property
    def gains(self) -> Gains:
        """Return the gains of the laws."""
        return Gains(self.event_gain_per_s, self.coverage_gain_per_s)


class PlannerTable(Table):
    """``[planner]``: the law by which agents move."""

    name: PlannerName = "law"
    """law (the control laws, speeds clipped) or receding (plans ahead)."""
    horizon: int = Field(default=1, ge=MIN_HORIZON, le=MAX_HORIZON)
    """Steps ahead."""
    lead_events: bool = False
    """Whether receding follows the estimated velocity of an event over the horizon."""


class CoverageFile(TaskFile):
    """A planopt problem file (TOML) of the task coverage."""

    world: WorldTable
    density: DensityTable = UniformTable(kind="uniform")
    """Weights."""
    agents: AgentsTable
    changes: list[ChangeTable] = Field(default=[], max_length=1000)
    """Of agents."""
    events: list[EventTable] = Field(default=[], max_length=50)
    """What appears."""
    sensor: SensorTable | None = None
    assignment: AssignmentTable = Field(default_factory=AssignmentTable)
    counting: Counting = Field(default_factory=Counting)
    links: LinkModel | None = None
    radio: RadioTable | None = None
    control: ControlTable
    planner: PlannerTable = Field(default_factory=PlannerTable)
