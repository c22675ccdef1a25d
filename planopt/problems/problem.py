"""A planning problem as plain frozen data, units in the names. No file, no solver, no truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from planopt.channel.multipath_models import Multipath
from planopt.channel.parameters import Station
from planopt.world.workspace import Workspace

CostToGo = Literal["geodesic", "connected"]
FitMethod = Literal["seed", "capped", "convex", "nls", "reml"]
PlannerName = Literal["auto", "lattice"]

MIN_HORIZON, MAX_HORIZON = 1, 500


@dataclass(frozen=True)
class Robot:
    """One robot and where it must go.

    Attributes
    ----------
    name
        What outputs call it.
    start_m, goal_m
        ``(x, y)`` in metres.
    speed_max_m_s
        Largest speed: the input set is the disc of this radius (single integrator).
    """

    name: str
    start_m: tuple[float, float]
    goal_m: tuple[float, float]
    speed_max_m_s: float


@dataclass(frozen=True)
class RadioStation:
    """A fixed station with its radio.

    Attributes
    ----------
    name
        What outputs call it.
    site
        Where it stands and how high.
    transmit_power_dbm
        Added to a truth map's path gain.
    threshold_dbm
        Upsilon_TH: received power from which on a robot is connected.
    """

    name: str
    site: Station
    transmit_power_dbm: float
    threshold_dbm: float


@dataclass(frozen=True)
class RasterTruth:
    """The true channel as a raster of path gains, with seeded small-scale fading on top.

    Attributes
    ----------
    file
        A map that :func:`planopt.world.raster_files.read_raster` reads.
    variable
        Name of the path gain in dB; NaN where nothing arrives.
    floor_db
        The receiver's floor as a path gain: smaller gains are clipped to it and censored.
    multipath
        The law of the fading, or None for none.
    """

    file: Path
    variable: str
    floor_db: float
    multipath: Multipath | None


@dataclass(frozen=True)
class ModelTruth:
    """The true channel drawn from the channel model itself, for synthetic problems.

    Attributes
    ----------
    k_pl_db, n_pl, shadow_std_db, decorrelation_m, multipath_std_db
        As in :class:`planopt.channel.parameters.ChannelParameters`; ``k_pl_db`` is a gain, to
        which the station's transmit power is added.
    cell_m
        Cell side of the drawn raster.
    floor_db
        As in :class:`RasterTruth`, or None for no floor.
    multipath
        Its law, of deviation ``multipath_std_db``; None for Gaussian in dB.
    """

    k_pl_db: float
    n_pl: float
    shadow_std_db: float
    decorrelation_m: float
    multipath_std_db: float
    cell_m: float
    floor_db: float | None
    multipath: Multipath | None = None


@dataclass(frozen=True)
class SampledMeasurements:
    """First measurements taken from the truth at `count` seeded random free places."""

    count: int


@dataclass(frozen=True)
class LoggedMeasurements:
    """First measurements read from a CSV log.

    Attributes
    ----------
    file
        The log.
    columns
        Column names of x, y and power.
    censored_column
        Column that marks censored rows, or None.
    floor_dbm
        Powers at or below this are censored, or None.
    """

    file: Path
    columns: tuple[str, str, str]
    censored_column: str | None
    floor_dbm: float | None


@dataclass(frozen=True)
class ChannelSetup:
    """Where the truth and the first measurements come from and how the channel is fitted.

    Attributes
    ----------
    truth
        What `simulate` drives in; None if there is none.
    measurements
        The first measurements.
    fit_method
        How parameters are estimated from them.
    measure_spacing_m
        On the way a robot measures again only at this distance from every earlier measurement:
        fading at one place keeps its value, so measuring it twice teaches nothing.
    """

    truth: RasterTruth | ModelTruth | None
    measurements: SampledMeasurements | LoggedMeasurements
    fit_method: FitMethod
    measure_spacing_m: float


@dataclass(frozen=True)
class ReachObjective:
    """Reach the goal in least time and effort.

    The cost is the integral of ``1 + effort_weight * speed**2`` until arrival, in seconds.

    Attributes
    ----------
    effort_weight_s2_m2
        Seconds of travel that one second at 1 m/s is worth, in s^2/m^2.
    cost_to_go
        What the way beyond the horizon costs: ``geodesic`` (shortest way round the obstacles) or
        ``connected`` (shortest way that keeps the predicted connectivity bound).
    """

    effort_weight_s2_m2: float
    cost_to_go: CostToGo


@dataclass(frozen=True)
class Constraints:
    """What every plan must keep.

    Attributes
    ----------
    p_min
        Least probability of connection at every step where that is possible.
    clearance_m
        Least distance of the whole swept path from every obstacle.
    goal_radius_m
        The goal is reached within this distance of it.
    """

    p_min: float
    clearance_m: float
    goal_radius_m: float


@dataclass(frozen=True)
class PlannerSettings:
    """How plans are found.

    Attributes
    ----------
    name
        ``auto`` (lattice, polish, verify) or ``lattice`` (no polish).
    horizon
        Steps ahead, N.
    step_s
        Duration of a step in seconds.
    neighbours
        Measurements that the solver conditions each stage on (design: 32 to 64).
    max_steps
        A closed loop that has not arrived by then ends.
    """

    name: PlannerName
    horizon: int
    step_s: float
    neighbours: int
    max_steps: int


@dataclass(frozen=True)
class ReportSettings:
    """What is drawn.

    Attributes
    ----------
    figures
        Whether pictures are drawn beside the results.
    """

    figures: bool = True


@dataclass(frozen=True)
class Problem:
    """Everything that defines one planning problem.

    Attributes
    ----------
    name, description
        For people.
    workspace
        Bounds and obstacles.
    channel, robots, stations, objective, constraints, planner
        The tables of the problem file.
    file
        Where it was read from, for messages; None if made in Python.
    report
        The table of that name.
    """

    name: str
    description: str
    workspace: Workspace
    channel: ChannelSetup
    robots: tuple[Robot, ...]
    stations: tuple[RadioStation, ...]
    objective: ReachObjective
    constraints: Constraints
    planner: PlannerSettings
    file: Path | None = None
    report: ReportSettings = ReportSettings()

    @property
    def step_length_m(self) -> float:
        """Longest way of the (first) robot in one step."""
        return self.robots[0].speed_max_m_s * self.planner.step_s
