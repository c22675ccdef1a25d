"""The tables of a problem file: every key with its type, range, default and meaning.

This is the definition that ``planopt schema`` prints and that every problem is validated against,
whether it comes from TOML, from a saved plan or from an override. What needs geometry or two
places at once (a start inside an obstacle) is in :mod:`planopt.problems.checks`, and what a task
asks of several tables in :mod:`planopt.problems.task_faults`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.problems.base_station import BaseStation
from planopt.problems.data_tables import TableOf
from planopt.problems.problem import Task
from planopt.problems.schema_channel import ChannelTable
from planopt.problems.schema_constraints import ConstraintsTable
from planopt.problems.schema_objective import ObjectiveTable
from planopt.problems.schema_robot import RobotTable
from planopt.problems.schema_world import WorldTable
from planopt.problems.settings import PlannerSettings, ReportSettings
from planopt.problems.tables import Decibels, FileName, Metres, Name, Pair, Table
from planopt.problems.target import Target
from planopt.problems.task_faults import task_fault

SCHEMA_VERSION = 1

MAX_STATIONS = 20
"""Each has a channel of its own, with a fit and a posterior."""


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


class StationTable(Table):
    """``[[stations]]``: a fixed station and its radio."""

    name: Name = Field(default=BaseStation.name, description="What outputs call it.")
    position_m: Pair = Field(description="Place [x, y] in metres; it may be outside the bounds.")
    height_m: Metres = Field(
        default=BaseStation.height_m,
        description="Height of its antenna above the robots' antennas, in metres.",
    )
    transmit_power_dbm: Decibels = Field(
        description="Transmit power in dBm; received power is this plus the path gain."
    )
    threshold_dbm: Decibels = Field(
        description="Received power in dBm from which on a robot is connected, as plans and proofs "
        "take it."
    )
    receive_threshold_dbm: Decibels | None = Field(
        default=BaseStation.receive_threshold_dbm,
        description="Received power in dBm from which on a robot truly is connected in a "
        "simulation, where that is not threshold_dbm.",
    )
    gain_file: FileName | None = Field(
        default=None,
        description="Map of its path gains, where channel.truth is a raster: in place of "
        "channel.truth.file. Each station needs a map of its own.",
    )
    gain_variable: str | None = Field(
        default=None,
        min_length=1,
        description="Name of its path gain in dB, in place of channel.truth.variable.",
    )
    log_file: FileName | None = Field(
        default=None,
        description="CSV log of its first measurements, in place of channel.measurements.file. "
        "Each station needs a log or a power_column of its own.",
    )
    power_column: str | None = Field(
        default=None,
        min_length=1,
        description="Column of its power in dBm in the log, in place of "
        "channel.measurements.columns.power.",
    )
    censored_column: str | None = Field(
        default=None,
        min_length=1,
        description="Column that marks its censored rows; of a log of its own, by default that of "
        "channel.measurements.",
    )


class ProblemFile(Table):
    """A planopt problem file (TOML)."""

    problem: ProblemTable
    world: WorldTable
    channel: ChannelTable
    robots: list[RobotTable] = Field(
        min_length=1, max_length=20, description="The robots; each has a goal for the task reach."
    )
    stations: list[StationTable] = Field(
        min_length=1,
        max_length=MAX_STATIONS,
        description="The fixed stations; connected is who reaches the threshold of any of them.",
    )
    targets: list[Annotated[Target, TableOf(Target, "TargetTable")]] = Field(
        default=[], max_length=1, description="The target, for the task track."
    )
    objective: ObjectiveTable = Field(default_factory=ObjectiveTable)
    constraints: ConstraintsTable = Field(default_factory=ConstraintsTable)
    planner: Annotated[PlannerSettings, TableOf(PlannerSettings, "PlannerTable")]
    report: Annotated[ReportSettings, TableOf(ReportSettings, "ReportTable")] = ReportSettings()

    @model_validator(mode="after")
    def _fits_the_task(self) -> ProblemFile:
        fault = task_fault(self)
        if fault is not None:
            raise PydanticCustomError("task", "{words}", {"words": fault})
        return self


def json_schema(model: type[Table] = ProblemFile) -> dict[str, Any]:
    """JSON schema of problem files (draft 2020-12), as ``planopt schema`` prints it."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **model.model_json_schema(),
    }
