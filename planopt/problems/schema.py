"""The tables of a problem file: every key with its type, range, default and meaning.

This is the definition that ``planopt schema`` prints and that every problem is validated against,
whether it comes from TOML, from a saved plan or from an override. What needs geometry or two
tables at once (a start inside an obstacle) is in :mod:`planopt.problems.checks`.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.problems.problem import Task
from planopt.problems.schema_channel import ChannelTable
from planopt.problems.schema_constraints import ConstraintsTable
from planopt.problems.schema_moving import MovingTable
from planopt.problems.schema_objective import (
    LearningTable,
    MappingTable,
    ObjectiveTable,
    TargetTable,
    TrackingTable,
)
from planopt.problems.schema_robot import RobotTable
from planopt.problems.schema_terms import (
    CasadiTable,
    TransmissionEnergyTable,
    UntilConnectedTable,
)
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON, PlannerName, ReportSettings
from planopt.problems.tables import Decibels, FileName, Metres, Name, Pair, Quad, Table

SCHEMA_VERSION = 1

MOST_TURN_RAD = 2.0 * math.pi
"""What a robot may turn in a step: more than a circle of the same input is nothing to plan."""


class ProblemTable(Table):
    """``[problem]``: what the problem is called and what it asks."""

    schema_version: Literal[1] = Field(
        alias="schema", description="Version of this schema; it is 1."
    )
    name: Name = Field(description="Name: letters, digits, '_' and '-'.")
    task: Task = Field(
        default="reach",
        description="What the robots must do: reach a goal, track a target, learn the path loss, "
        "map the channel, connect after a short way, or custom: what one's own terms say.",
    )
    description: str = Field(default="", description="One sentence for people.")


class ObstacleTable(Table):
    """One entry of ``obstacles``: exactly one of ``file``, ``polygon`` and ``wkt``."""

    name: str | None = Field(
        default=None,
        description="What messages call it, for polygon and wkt; a file's obstacles have names.",
    )
    file: FileName | None = Field(
        default=None,
        description="GeoJSON (.geojson), WKT (.wkt) or building file (.json), in metres, "
        "relative to the problem file.",
    )
    polygon: list[Pair] | None = Field(
        default=None, min_length=3, description="Outer ring, a list of [x, y] in metres."
    )
    holes: list[Annotated[list[Pair], Field(min_length=3)]] = Field(
        default=[], description="Rings of holes in polygon, each a list of [x, y] in metres."
    )
    wkt: str | None = Field(default=None, min_length=1, description="A POLYGON in metres.")

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


class StationTable(Table):
    """``[[stations]]``: a fixed station and its radio."""

    name: Name = Field(default="station", description="What outputs call it.")
    position_m: Pair = Field(description="Place [x, y] in metres; it may be outside the bounds.")
    height_m: Metres = Field(
        default=0.0, description="Height of its antenna above the robots' antennas, in metres."
    )
    transmit_power_dbm: Decibels = Field(
        description="Transmit power in dBm; received power is this plus the path gain."
    )
    threshold_dbm: Decibels = Field(
        description="Received power in dBm from which on a robot is connected."
    )


class PlannerTable(Table):
    """``[planner]``: how plans are found."""

    name: PlannerName = Field(
        default="auto",
        description="nlp (lattice, polish by IPOPT, verify), scp (polish by sequential convex "
        "programming), auto (the better of them, nlp), lattice (no polish), and for tasks other "
        "than reach one_step, random or lawnmower.",
    )
    horizon: int = Field(
        default=10, ge=MIN_HORIZON, le=MAX_HORIZON, description="Steps ahead, the seed's N."
    )
    step_s: float = Field(gt=0, le=1e4, description="Duration of a step in seconds.")
    neighbours: int = Field(
        default=48,
        ge=4,
        le=512,
        description="Measurements that the solver conditions each stage on (a number).",
    )
    max_steps: int = Field(
        default=400,
        ge=1,
        le=100_000,
        description="A closed loop that has not arrived after this many steps ends.",
    )
    budget_s: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="Seconds after which no new polish of a plan begins, and after which one that "
        "was begun ends; left out: no limit.",
    )


class ReportTable(Table):
    """``[report]``: what is drawn."""

    figures: bool = Field(
        default=ReportSettings().figures, description="Draw the pictures (true or false)."
    )


class ProblemFile(Table):
    """A planopt problem file (TOML)."""

    problem: ProblemTable
    world: WorldTable
    channel: ChannelTable
    robots: list[RobotTable] = Field(
        min_length=1, max_length=20, description="The robots; exactly one for the task reach."
    )
    stations: list[StationTable] = Field(
        min_length=1,
        max_length=1,
        description="The fixed stations; this version plans with exactly one.",
    )
    targets: list[TargetTable] = Field(
        default=[], max_length=1, description="The target, for the task track."
    )
    objective: ObjectiveTable = Field(default_factory=ObjectiveTable)
    constraints: ConstraintsTable = Field(default_factory=ConstraintsTable)
    planner: PlannerTable
    report: ReportTable = Field(default_factory=ReportTable)

    @model_validator(mode="after")
    def _fits_the_task(self) -> ProblemFile:
        fault = _reach_fault(self) if self.problem.task == "reach" else _terms_fault(self)
        fault = fault or _moving_fault(self)
        if fault is not None:
            raise PydanticCustomError("task", "{words}", {"words": fault})
        return self


TASK_TERMS: dict[str, tuple[type[Table], ...]] = {
    "track": (TrackingTable,),
    "learn": (LearningTable,),
    "map": (MappingTable,),
    "connect": (UntilConnectedTable,),
    "custom": (CasadiTable, TransmissionEnergyTable),
}
"""The terms that each task's objective may begin with."""


def _reach_fault(tables: ProblemFile) -> str | None:
    """What keeps tables from being a problem that is to reach a goal."""
    if len(tables.robots) > 1:
        return "task reach is for exactly one robot"
    if tables.robots[0].goal_m is None:
        return "task reach needs robots[0].goal_m"
    if tables.objective.terms:
        return "task reach has no objective.terms"
    if tables.targets:
        return "task reach has no targets"
    if tables.constraints.p_min == 0.0 and tables.constraints.connectivity != "data":
        return "task reach needs constraints.p_min above 0"
    if tables.planner.name in ("one_step", "random", "lawnmower"):
        return (
            f"planner.name {tables.planner.name} is not for task reach: use auto, nlp, scp or "
            "lattice"
        )
    if tables.robots[0].dynamics != "single_integrator":
        dynamics = tables.robots[0].dynamics
        return f"task reach is for robots of dynamics single_integrator, not {dynamics}"
    return None


def _terms_fault(tables: ProblemFile) -> str | None:
    """What keeps tables from being a problem whose objective is a sum of terms."""
    task, terms = tables.problem.task, tables.objective.terms
    if not terms or not isinstance(terms[0], TASK_TERMS[task]):
        kinds = [get_args(each.model_fields["kind"].annotation)[0] for each in TASK_TERMS[task]]
        return f"task {task} needs objective.terms that begin with one of kind {' or '.join(kinds)}"
    if any(robot.goal_m is not None for robot in tables.robots):
        return f"task {task} has no robots.goal_m"
    for key in ("effort_weight_s2_m2", "cost_to_go"):
        if key in tables.objective.model_fields_set:
            return f"objective.{key} is for task reach, not for {task}"
    tracked = any(isinstance(term, TrackingTable) for term in terms)
    if tracked != bool(tables.targets):
        return "a term of kind tracking and an entry of targets go together"
    names = [robot.name for robot in tables.robots]
    if len(set(names)) < len(names):
        return "two robots have one name"
    return _dynamics_fault(tables)


def _dynamics_fault(tables: ProblemFile) -> str | None:
    """What keeps robots that cannot turn or stop at will from being planned for."""
    for number, robot in enumerate(tables.robots):
        if robot.dynamics == "single_integrator":
            continue
        if tables.planner.name in ("one_step", "random", "lawnmower"):
            return (
                f"planner.name {tables.planner.name} is for robots of dynamics single_integrator, "
                f"robots[{number}] has {robot.dynamics}: use auto, nlp, scp or lattice"
            )
        turn_rad = (robot.turn_rate_max_rad_s or 0.0) * tables.planner.step_s
        if turn_rad > MOST_TURN_RAD:
            return (
                f"robots[{number}].turn_rate_max_rad_s lets it turn by {turn_rad:.3g} rad in a "
                f"step, which should be at most a full circle: lessen it or planner.step_s"
            )
    return None


def _moving_fault(tables: ProblemFile) -> str | None:
    """What keeps moving things from being told apart."""
    names = [moving.name for moving in tables.world.moving]
    if len(set(names)) < len(names):
        return "two of world.moving have one name"
    return None


def json_schema() -> dict[str, Any]:
    """JSON schema of problem files (draft 2020-12), as ``planopt schema`` prints it."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **ProblemFile.model_json_schema(),
    }
