"""Problem files of the task "pursuit", and the simulation scenes built from them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from planopt.arrays import Floats, Mask
from planopt.errors import InputError
from planopt.keys import SMALLEST, Distance, Length, Name, Pair, Table
from planopt.problems.schema import TaskFile, WorldTable
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.problems.tasks import TaskProblem
from planopt.pursuit.arena import EVADER_SHARE, Arena, arena_of
from planopt.pursuit.certificate import Distances, Theorem, flaws_of
from planopt.pursuit.design import MAX_BITS
from planopt.pursuit.detection import AssociatedRecords, RecordSource
from planopt.pursuit.evaders import Behaviour
from planopt.pursuit.guarantees import (
    Chase,
    Guarantee,
    capture_guarantees,
    guarantees_among_obstacles,
)
from planopt.pursuit.pursuers import (
    DriveToReport,
    Motion,
    Policy,
    RecedingHorizon,
    StraightMotion,
    UnicycleMotion,
)
from planopt.pursuit.service import (
    HOPS_PER_ROUND,
    MAX_LEVELS,
    Record,
    SnapshotRecords,
    SnapshotService,
    UpdateRule,
)
from planopt.pursuit.simulation import Evader, Pursuer, Scene
from planopt.robots.models import Unicycle
from planopt.world.workspace import Workspace

LOST_ROUNDS = 4096  # Number of rounds per level for which losses are drawn; the pattern is repeated
START_DRAWS = 1000  # Maximum number of positions drawn for a start in free space

PlannerName = Literal["drive", "retarget", "receding"]


class DetectionTable(Table):
    """Table ``[network.detection]``: motes that detect imperfectly and do not name the evader.

    Pursuers associate the reports with the evaders. Initially they know start_m and start_radius_m.
    """

    miss_probability: float = Field(default=0.0, ge=0, lt=1)
    """Probability that an evader is not detected at a sample time, independently of the others."""
    false_alarms: float = Field(default=0.0, ge=0, le=100)
    """Expected number of false alarms at a sample time, uniform over the square of 4^L motes."""


class ServiceTable(Table):
    """Table ``[network]``: mote grid and snapshot service."""

    levels: int = Field(ge=1, le=MAX_LEVELS)
    """Number of levels L; the grid has 2^L by 2^L motes."""
    mote_spacing_m: Length
    """Distance between neighbouring motes in metres."""
    frame_s: float = Field(ge=SMALLEST, le=1e6)
    """Duration of a TDMA frame in seconds: number of slots times slot width."""
    bits_per_axis: int = Field(ge=1, le=MAX_BITS)
    """Bits c per axis of a reported position."""
    hops_per_round: int = Field(default=HOPS_PER_ROUND, ge=HOPS_PER_ROUND, le=1000)
    """Frames per level-0 round."""
    rate_divisor: int = Field(default=1, ge=1, le=1000)
    """Rate divisor r: rounds start at intervals of r round lengths."""
    endless: bool = False
    """True if the mote grid is unbounded; required without [world]."""
    loss_probability: float = Field(default=0.0, ge=0, lt=1)
    """Probability that a round's report of the evader is lost, independently of the others."""
    updates: UpdateRule = "full"
    """Reports that a round sends: full (all), sparse (changed ones; silence means no change) or
    directed (sparse, and only towards places where a pursuer may be until the next round)."""
    detection: DetectionTable | None = None
    """Detection errors; default: every evader is detected and named."""


class RulesTable(Table):
    """Table ``[pursuit]``: termination and required guarantee."""

    capture_radius_m: Length
    """Distance in metres at which an evader is captured."""
    step_s: float = Field(ge=SMALLEST, le=1e4)
    """Time in seconds between decisions of pursuers and evaders."""
    max_steps: int = Field(default=5000, ge=1, le=100_000)
    """Maximum number of steps of the pursuit."""
    clearance_m: Length = 1.0
    """Distance in metres that pursuers and evaders keep from obstacles."""
    guarantee: Literal["any_instant", "snapshots"] | None = None
    """Theorem that must guarantee capture, otherwise no plan is returned; default: none."""


class EvaderTable(Table):
    """Table ``[[evaders]]``: an evader."""

    name: Name = "evader"
    """Name in outputs."""
    start_m: Pair
    """Start [x, y] in metres."""
    start_radius_m: Distance = 0.0
    """Radius in metres around start_m within which the start is drawn."""
    speed_max_m_s: float = Field(ge=0, le=1e4)
    """Largest speed in m/s."""
    behaviour: Behaviour = Field(discriminator="kind")
    """Behaviour of the evader: a table with kind."""


class PursuerTable(Table):
    """Table ``[[pursuers]]``: a pursuer."""

    name: Name = "pursuer"
    """Name in outputs."""
    start_m: Pair
    """Start [x, y] in metres."""
    start_radius_m: Distance = 0.0
    """Radius in metres around start_m within which the start is drawn."""
    speed_max_m_s: float = Field(ge=SMALLEST, le=1e4)
    """Largest speed in m/s."""
    turn_rate_max_rad_s: float | None = Field(default=None, ge=SMALLEST, le=1e3)
    """Turn rate limit of a unicycle in rad/s; default: holonomic motion. A unicycle drives arcs in
    open space, and turns on the spot among obstacles."""

    def motion(self, arena: Arena) -> Motion:
        """Return the motion model of the pursuer in an arena."""
        if self.turn_rate_max_rad_s is None:
            return StraightMotion(self.speed_max_m_s)
        robot = Unicycle(self.speed_max_m_s, self.turn_rate_max_rad_s)
        return UnicycleMotion(robot, arcs=arena.obstacles is None)


class PlannerTable(Table):
    """Table ``[planner]``: policy of the pursuers."""

    name: PlannerName = "drive"
    """Policy: drive (to the reported position, then to the next), retarget (immediately to every
    newer report) or receding (predict the evader and plan an interception)."""
    horizon: int = Field(default=10, ge=MIN_HORIZON, le=MAX_HORIZON)
    """Horizon in plan steps, for receding."""
    plan_step_s: float = Field(default=2.0, ge=SMALLEST, le=1e4)
    """Length of a plan step in seconds, for receding."""
    manoeuvre_s: float = Field(default=60.0, ge=SMALLEST, le=1e6)
    """Decorrelation time of an evader's velocity in seconds, for receding."""

    @property
    def policy(self) -> Policy:
        """Return the policy of the pursuers."""
        if self.name == "receding":
            return partial(
                RecedingHorizon,
                horizon=self.horizon,
                plan_step_s=self.plan_step_s,
                manoeuvre_s=self.manoeuvre_s,
            )
        return partial(DriveToReport, retarget=self.name == "retarget")


class PursuitFile(TaskFile):
    """Problem file (TOML) of the task pursuit."""

    world: WorldTable | None = None
    """Bounds and obstacles; without them the space is unbounded and free."""
    network: ServiceTable
    pursuit: RulesTable
    pursuers: list[PursuerTable] = Field(min_length=1, max_length=50)
    """List of pursuers."""
    evaders: list[EvaderTable] = Field(min_length=1, max_length=50)
    """List of evaders."""
    planner: PlannerTable = Field(default_factory=PlannerTable)


@dataclass(frozen=True, eq=False, repr=False)
class PursuitProblem(TaskProblem):
    """Problem of the task pursuit."""

    config: PursuitFile
    service: SnapshotService
    arena: Arena

    def scene(self, generator: np.random.Generator) -> Scene:
        """Return the scene of one run with drawn starts and lost rounds."""
        config, rules = self.config, self.config.pursuit
        starts, begins = (
            [
                self._start_m(f"{key}[{index}].start_m", each, generator)
                for index, each in enumerate(tables)
            ]
            for key, tables in (("pursuers", config.pursuers), ("evaders", config.evaders))
        )
        lost, probability = None, config.network.loss_probability
        if probability > 0.0:
            shape = (config.network.levels + 1, LOST_ROUNDS)
            lost = generator.random(shape) < probability
        return Scene(
            tuple(
                Pursuer(start, each.motion(self.arena), config.planner.policy)
                for start, each in zip(starts, config.pursuers, strict=True)
            ),
            tuple(
                Evader(start, each.speed_max_m_s, each.behaviour)
                for start, each in zip(begins, config.evaders, strict=True)
            ),
            self._source(lost, generator),
            rules.capture_radius_m,
            rules.step_s,
            rules.max_steps,
            self.arena,
        )

    def _source(self, lost: Mask | None, generator: np.random.Generator) -> RecordSource:
        """Return the source of the pursuers' records, with drawn detection errors."""
        errors, evaders = self.config.network.detection, self.config.evaders
        if errors is None:
            return SnapshotRecords(self.service, lost)
        starts = [Record(0.0, np.array(each.start_m), each.start_radius_m) for each in evaders]
        fastest = max(each.speed_max_m_s for each in evaders)
        rates = errors.miss_probability, errors.false_alarms
        return AssociatedRecords(self.service, rates, starts, fastest, generator, lost)

    def _start_m(
        self, key: str, table: PursuerTable | EvaderTable, generator: np.random.Generator
    ) -> Floats:
        for _ in range(START_DRAWS if table.start_radius_m > 0.0 else 1):
            away_m = table.start_radius_m * math.sqrt(generator.uniform())
            turn = generator.uniform(0.0, 2.0 * math.pi)
            place = np.array(table.start_m) + away_m * np.array([math.cos(turn), math.sin(turn)])
            if self.arena.is_free(place, EVADER_SHARE):
                return place
        raise InputError(
            f"{table.name} has no free start position",
            key=key,
            remedy="keep the start within world.bounds_m and at least 1.15 times "
            "pursuit.clearance_m away from obstacles",
        )

    def guarantees(self, pursuer: int, evader: int) -> dict[Theorem, Guarantee]:
        """Return the guarantees of one pursuer that chases one evader."""
        # A stage takes one step (and one turn of a unicycle) longer than straight driving; each
        # path corner adds the same delay. With obstacles, the distance with the lower floor counts.
        motion = self.config.pursuers[pursuer].motion(self.arena)
        speed = max(self.config.evaders[evader].speed_max_m_s, LEAST_SPEED_M_S)
        delay_s = (1 + self.arena.corners) * (self.config.pursuit.step_s + motion.turning_s)
        chase, bounds = Chase(speed, motion.speed_max_m_s, delay_s), self.service.bounds
        if self.arena.obstacles is None:
            found = capture_guarantees(chase, bounds)
        else:
            kinds = guarantees_among_obstacles(chase, bounds, self.arena.detour)
            found = {
                theorem: min(
                    (each[theorem] for each in kinds.values()), key=lambda one: one.floor_m
                )
                for theorem in kinds[Distances.PATHS]
            }
        network = self.config.network
        flaws = flaws_of(network.loss_probability, network.detection is not None)
        return {
            theorem: replace(each, inequalities=(*flaws, *each.inequalities))
            for theorem, each in found.items()
        }

    def words(self) -> Sequence[str]:
        """Return a text summary of the problem, line by line."""
        config, service = self.config, self.service
        side = service.motes_per_side
        lines = [
            f"{self.name}: {self.description}",
            f"  task        pursuit, planner {config.planner.name}, "
            f"at most {config.pursuit.max_steps} steps of {config.pursuit.step_s:g} s",
            f"  network     {side} x {side} sensor nodes (motes), {service.mote_spacing_m:g} m "
            f"apart, TDMA frames of {service.frame_s:g} s",
            f"  reports     {service.bits_per_axis} bits for each coordinate of a position",
            f"  capture     at a distance of {config.pursuit.capture_radius_m:g} m or less",
            f"  world       {len(self.obstacles)} obstacles",
        ]
        for each in (*config.pursuers, *config.evaders):
            evades = isinstance(each, EvaderTable)
            kind = f"{each.behaviour.kind}, " if evades else ""
            lines.append(
                f"  {'evader ' if evades else 'pursuer'}     {each.name} from "
                f"({each.start_m[0]:g}, {each.start_m[1]:g}) m, {kind}at most "
                f"{each.speed_max_m_s:g} m/s"
            )
        return lines


LEAST_SPEED_M_S = 1e-9
"""Speed assumed for a static evader, since the theorems divide by evader speed."""


def build(config: PursuitFile, folder: Path, file: Path | None) -> PursuitProblem:
    """Build the problem from validated tables."""
    keys = {each.name for each in fields(SnapshotService)}
    service = SnapshotService(**config.network.model_dump(include=keys))
    arena = Arena()
    if config.world is not None:
        workspace = Workspace(config.world.bounds_m, config.world.obstacles)
        arena = arena_of(workspace, config.pursuit.clearance_m)
    _require_covered(config, service)
    network = config.network
    # The mode `updates` relies on silence.
    if network.updates != "full" and (network.loss_probability > 0.0 or network.detection):
        raise InputError(
            f'cannot be "{network.updates}" if reports are lost or evaders are missed: silence '
            "then does not mean that a report is unchanged",
            key="network.updates",
            remedy='use "full", or leave out network.loss_probability and network.detection',
        )
    problem = PursuitProblem(config, file, service, arena)
    problem.scene(np.random.default_rng(0))
    return problem


def _require_covered(config: PursuitFile, service: SnapshotService) -> None:
    if config.network.endless:
        return
    if config.world is None:
        raise InputError(
            "is false, but no [world] keeps the evader on the mote grid",
            key="network.endless",
            remedy="set it to true, or give world.bounds_m within the grid",
        )
    x_min, y_min, x_max, y_max = config.world.bounds_m
    if min(x_min, y_min) < 0.0 or max(x_max, y_max) > service.side_m:
        raise InputError(
            f"leaves the mote grid, the square from (0, 0) to ({service.side_m:g}, "
            f"{service.side_m:g}) m",
            key="world.bounds_m",
            remedy="reduce the bounds, or set network.endless = true",
        )
