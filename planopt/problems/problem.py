"""A planning problem as plain frozen data, units in the names. No file, no solver, no truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from planopt.channel.multipath.multipath_models import Multipath
from planopt.channel.parameters import Station
from planopt.world.workspace import Workspace

CostToGo = Literal["geodesic", "connected"]
FitMethod = Literal["seed", "capped", "convex", "nls", "reml"]
Task = Literal["reach", "track", "learn", "map"]
LearningCriterion = Literal["T", "D", "A", "V"]
MappingForm = Literal["two_layer", "path", "information", "average"]
PlannerName = Literal["auto", "lattice", "one_step", "random", "lawnmower"]

MIN_HORIZON, MAX_HORIZON = 1, 500


@dataclass(frozen=True)
class Robot:
    """One robot.

    Attributes
    ----------
    name
        What outputs call it.
    start_m
        ``(x, y)`` in metres.
    goal_m
        Where it must go; None unless the task is to reach a goal.
    speed_max_m_s
        Largest speed: the input set is the disc of this radius (single integrator).
    """

    name: str
    start_m: tuple[float, float]
    goal_m: tuple[float, float] | None
    speed_max_m_s: float


@dataclass(frozen=True)
class Target:
    """A moving target and what is known of it at the start (seed, section III-B).

    Attributes
    ----------
    name
        What outputs call it.
    start_m, velocity_m_s
        Where it truly is and how it moves at the start, ``(x, y)``.
    acceleration_std_m_s2
        Deviation of the white acceleration along either axis (the seed's Theta is its square).
    position_std_m, velocity_std_m_s
        Deviation of the first estimate of position and velocity along either axis (P_0).
    """

    name: str
    start_m: tuple[float, float]
    velocity_m_s: tuple[float, float]
    acceleration_std_m_s2: float
    position_std_m: float
    velocity_std_m_s: float


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
class TrackingTerm:
    """Expected information on the target that reaches the station (seed, (4); theory 4.6).

    Each step is worth P(connected) / g(r), with r the distance to the target's predicted position
    and ``g(r) = noise_curvature (r - sweet_spot_m)^2 + noise_floor_m2``.

    Attributes
    ----------
    weight
        In the sum of terms.
    noise_curvature, noise_floor_m2, sweet_spot_m
        The seed's varpi, nu (m^2) and r_s.
    """

    weight: float
    noise_curvature: float
    noise_floor_m2: float
    sweet_spot_m: float


@dataclass(frozen=True)
class LearningTerm:
    """Information on path loss gathered along the way (seed, (2); theory 4.4).

    Attributes
    ----------
    weight
        In the sum of terms.
    criterion
        ``T`` (the seed's trace), ``D``, ``A`` or ``V`` (prediction over the workspace).
    """

    weight: float
    criterion: LearningCriterion


@dataclass(frozen=True)
class MappingTerm:
    """Uncertainty of the channel removed along the way (seed, (3); theory 4.5).

    Attributes
    ----------
    weight
        In the sum of terms.
    form
        ``two_layer`` (the seed's: steer to the maximiser of J_CH), ``path`` (J_CH summed along the
        path), ``information`` or ``average`` (over the workspace, the seed's footnote 3).
    variance_threshold_db2
        sigma_TH^2 in dB^2.
    closeness_per_m
        zeta of ``psi(d) = exp(-zeta d)``.
    """

    weight: float
    form: MappingForm
    variance_threshold_db2: float
    closeness_per_m: float


@dataclass(frozen=True)
class MotionEnergyTerm:
    """Energy of motion, a cost (theory 3.2): k1 |v| + k2 while moving, in joules.

    Attributes
    ----------
    weight
        In the sum of terms, per joule; the energy is subtracted.
    per_metre_j_m, power_w
        k1 and k2.
    """

    weight: float
    per_metre_j_m: float
    power_w: float


Term = TrackingTerm | LearningTerm | MappingTerm | MotionEnergyTerm


@dataclass(frozen=True)
class TermsObjective:
    """A weighted sum of named terms over the horizon, to be maximised.

    Attributes
    ----------
    terms
        At least one; the first is the task's.
    """

    terms: tuple[Term, ...]


@dataclass(frozen=True)
class Constraints:
    """What every plan must keep.

    Attributes
    ----------
    p_min
        Least probability of connection at every step where that is possible; 0 asks for none.
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
        ``auto`` (lattice, polish, verify), ``lattice`` (no polish), and for tasks other than reach
        ``one_step`` (the seed's dense local search), ``random`` and ``lawnmower``.
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
    report, targets
        The tables of these names.
    """

    name: str
    description: str
    workspace: Workspace
    channel: ChannelSetup
    robots: tuple[Robot, ...]
    stations: tuple[RadioStation, ...]
    objective: ReachObjective | TermsObjective
    constraints: Constraints
    planner: PlannerSettings
    file: Path | None = None
    report: ReportSettings = ReportSettings()
    targets: tuple[Target, ...] = ()

    @property
    def step_length_m(self) -> float:
        """Longest way of the (first) robot in one step."""
        return self.robots[0].speed_max_m_s * self.planner.step_s

    @property
    def reach(self) -> ReachObjective:
        """The objective of a problem that is to reach a goal; others have none."""
        if not isinstance(self.objective, ReachObjective):
            raise AssertionError(f"the task of {self.name} is not to reach a goal")
        return self.objective

    @property
    def goal_m(self) -> tuple[float, float]:
        """Where the (first) robot must go; only in a problem that is to reach a goal."""
        goal = self.robots[0].goal_m
        if goal is None:
            raise AssertionError(f"the task of {self.name} is not to reach a goal")
        return goal

    @property
    def sense(self) -> Literal["min", "max"]:
        """Whether less or more of the objective is better."""
        return "min" if isinstance(self.objective, ReachObjective) else "max"

    @property
    def cost_to_go(self) -> CostToGo | None:
        """What the way beyond the horizon costs; None where there is no goal."""
        return self.objective.cost_to_go if isinstance(self.objective, ReachObjective) else None

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the objective; none where the task is to reach a goal."""
        return self.objective.terms if isinstance(self.objective, TermsObjective) else ()

    @property
    def task(self) -> Task:
        """What the problem asks: its goal, or its first term."""
        if isinstance(self.objective, ReachObjective):
            return "reach"
        first = self.objective.terms[0]
        if isinstance(first, TrackingTerm):
            return "track"
        return "learn" if isinstance(first, LearningTerm) else "map"
