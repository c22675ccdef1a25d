"""Schema of problem files, and the requirements of a task on several tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import shapely
from pydantic import AfterValidator, Field, PlainSerializer, Strict, ValidationInfo, model_validator

from planopt.errors import InputError
from planopt.keys import (
    FileName,
    Name,
    OriginKey,
    Pair,
    Quad,
    ReadAs,
    Table,
    ValidatedAs,
    fault_of,
    folder_of,
    saved,
)
from planopt.objectives.terms.term import Term, registered_terms
from planopt.problems.channel_setup import BaseStation, ChannelSetup
from planopt.problems.objective import OBJECTIVE, Constraints, ReachObjective, TermsObjective
from planopt.problems.robot import Robot
from planopt.problems.settings import (
    ComparisonSettings,
    PlannerSettings,
    ReportSettings,
    Target,
    names_with,
    planner_kind,
)
from planopt.robots.models import Unicycle
from planopt.world.occupancy import UnknownCells, is_grid
from planopt.world.readers import obstacle_from_wkt, read_obstacles
from planopt.world.workspace import MovingObstacle, Obstacle, Workspace, footprint


class ObstacleTable(Table):
    """Entry of ``obstacles`` with exactly one of ``file``, ``polygon`` and ``wkt``."""

    name: str | None = None
    """Name in messages, for polygon and wkt; obstacles in files have their own names."""
    file: FileName | None = None
    """GeoJSON (.geojson), WKT (.wkt), building file (.json) or occupancy grid (.yaml as in ROS,
    .csv), in metres, relative to the problem file."""
    unknown: UnknownCells = "occupied"
    """State assumed for unknown cells of an occupancy grid: occupied or free."""
    origin_deg: OriginKey = None
    """Latitude and longitude in degrees of (0, 0), and the angle in degrees from east to the x axis
    if it is not 0: GeoJSON in degrees, or with a reference system, becomes metres."""
    polygon: list[Pair] | None = Field(default=None, min_length=3)
    """Outer ring, a list of [x, y] in metres."""
    holes: tuple[Annotated[list[Pair], Field(min_length=3)], ...] = Field(default=(), strict=False)
    """Rings of holes in polygon, each a list of [x, y] in metres."""
    wkt: str | None = Field(default=None, min_length=1)
    """Polygon in well-known text (POLYGON), in metres."""
    known_from_s: float = Field(default=Obstacle.known_from_s, ge=0, le=1e9)
    """Time in seconds at which the obstacle appears; earlier plans do not know of it."""
    until_s: float | None = Field(default=None, gt=0, le=1e9)
    """Time in seconds at which the obstacle vanishes, unknown to earlier plans; default: never."""

    @model_validator(mode="after")
    def _one_source(self) -> ObstacleTable:
        given = [key for key in ("file", "polygon", "wkt") if getattr(self, key) is not None]
        if len(given) != 1:
            raise fault_of(
                "needs exactly one of file, polygon and wkt, but has "
                f"{' and '.join(given) or 'none'}: write for instance polygon = [[x, y], ...] "
                "in metres"
            )
        if self.holes and self.polygon is None:
            raise fault_of(
                "has holes, which apply only to polygon: leave them out, since a "
                "file and wkt contain their own"
            )
        if "unknown" in self.model_fields_set and not is_grid(self.file):
            raise fault_of(
                "has unknown, which applies only to an occupancy grid in a file: leave it out"
            )
        if self.until_s is not None and self.until_s <= self.known_from_s:
            raise fault_of(
                "has until_s that is not after known_from_s: give a later time, or "
                "leave until_s out"
            )
        if self.name is not None and self.file is not None:
            raise fault_of(
                "has a name, which applies only to polygon and wkt: leave it out, since a "
                "file contains its own names"
            )
        return self


def _read_entries(entries: Sequence[ObstacleTable], info: ValidationInfo) -> tuple[Obstacle, ...]:
    """Return the obstacles of ``world.obstacles``, read from their files; errors name the entry."""
    found: list[Obstacle] = []
    for index, entry in enumerate(entries):
        key, name = f"world.obstacles[{index}]", entry.name or f"obstacle {index}"
        until_s = math.inf if entry.until_s is None else entry.until_s
        try:
            if entry.file is not None:
                path = folder_of(info) / entry.file
                own = read_obstacles(path, entry.unknown, entry.origin_deg)
            elif entry.wkt is not None:
                own = (obstacle_from_wkt(name, entry.wkt),)
            else:
                own = (footprint(name, entry.polygon, entry.holes),)
        except InputError as error:
            raise InputError(
                error.message,
                file=error.file,
                key=error.key or key,
                row=error.row,
                remedy=error.remedy,
            ) from error
        found += [replace(each, known_from_s=entry.known_from_s, until_s=until_s) for each in own]
    return tuple(found)


def _entries_of(obstacles: Sequence[Obstacle]) -> list[dict[str, Any]]:
    """Return obstacles as entries of ``world.obstacles``."""
    tables: list[dict[str, Any]] = []
    for each in obstacles:
        outline, *holes = (
            shapely.get_coordinates(ring).tolist() for ring in shapely.get_rings(each.polygon)
        )
        table: dict[str, Any] = {"name": each.name, "polygon": outline}
        if each.known_from_s > 0.0:
            table["known_from_s"] = each.known_from_s
        if each.until_s < math.inf:
            table["until_s"] = each.until_s
        tables.append({**table, "holes": holes} if holes else table)
    return tables


Obstacles = Annotated[
    tuple[Obstacle, ...],
    ValidatedAs(Annotated[tuple[ObstacleTable, ...], Strict(False)]),
    AfterValidator(_read_entries),
    PlainSerializer(_entries_of),
]
"""Obstacles from their entries in a problem file; saved as polygons."""


class WorldTable(Table):
    """Table ``[world]``: bounds and obstacles."""

    bounds_m: Quad
    """[x_min, y_min, x_max, y_max] in metres."""
    obstacles: Obstacles = ()
    """Forbidden areas."""


class MotionWorldTable(WorldTable):
    """Table ``[world]``: bounds, obstacles and moving obstacles."""

    moving: tuple[MovingObstacle, ...] = Field(default=(), strict=False, max_length=50)
    """Moving obstacles with predicted trajectories."""


WORLD = ReadAs(
    MotionWorldTable,
    lambda table: Workspace(table.bounds_m, table.obstacles, table.moving),
    Workspace,
    # The obstacles of a workspace built in Python are already validated.
    to_keys=lambda workspace: {"bounds_m": workspace.bounds_m, "moving": workspace.moving},
)


def world_table(workspace: Workspace) -> dict[str, Any]:
    """Return the complete table ``[world]`` with obstacles as polygons."""
    return {
        "bounds_m": list(workspace.bounds_m),
        "obstacles": _entries_of((*workspace.lasting, *workspace.timed)),
        "moving": saved(workspace.moving),
    }


Task = Literal["reach", "track", "learn", "map", "connect", "custom"]

MOST_TURN_RAD = 2.0 * math.pi  # Largest turn of a robot in a step: a full circle


def _reach_fault(tables: ProblemFile) -> str | None:
    """Return a message if the tables do not define a problem of the task reach."""
    for number, robot in enumerate(tables.robots):
        if robot.goal_m is None:
            return (
                f'the task "reach" needs robots[{number}].goal_m: write goal_m = [x, y] in metres, '
                'or choose another problem.task, such as "learn"'
            )
        if robot.weights:
            return (
                f'the task "reach" has no terms, so robots[{number}].weights has no effect: leave '
                'it out, or choose another problem.task and add a term of kind "goal"'
            )
    if tables.objective.terms:
        return (
            'the task "reach" has no objective.terms: leave them out, or choose the problem.task '
            'of the first term, and add a term of kind "goal"'
        )
    if tables.targets:
        return 'the task "reach" has no targets: leave them out, or write problem.task = "track"'
    if not tables.constraints.requires_connection:
        return 'the task "reach" needs constraints.p_min above 0: write p_min = 0.9, for instance'
    if not planner_kind(tables.planner.name).reaches_goals:
        return (
            f'planner.name is "{tables.planner.name}", which cannot plan to a goal: use '
            f"{names_with('reaches_goals')}"
        )
    return _same_name("robots", tables.robots) or _dynamics_fault(tables)


def _terms_fault(tables: ProblemFile) -> str | None:
    """Return a message if the tables do not define a problem with a sum of terms."""
    task, objective = tables.problem.task, tables.objective
    terms = objective.terms
    if not terms or terms[0].task != task:
        kinds = [each.kind for each in registered_terms() if each.task == task]
        given = (
            f'; a first term of kind "{terms[0].kind}" belongs to the task '
            f'"{terms[0].task or "custom"}"'
            if terms
            else ""
        )
        return (
            f'the task "{task}" needs a first entry of objective.terms of kind '
            f"{' or '.join(kinds) or 'your own'}: add it first, or change problem.task{given}"
        )
    leads = any(term.steers == "goal" for term in terms)
    for number, robot in enumerate(tables.robots):
        fault = _fault_of_robot(terms, robot, number)
        if fault is not None:
            return fault
        if not leads and robot.goal_m is not None:
            return (
                f"robots[{number}].goal_m has no effect, since objective.terms has no term of "
                f'kind "goal": leave it out, or add such a term'
            )
    if not leads and tables.constraints.goal_radius_m != Constraints.goal_radius_m:
        return (
            'constraints.goal_radius_m applies only to the task "reach" and to terms of kind '
            '"goal": leave it out, or add such a term to objective.terms'
        )
    tracked = any(term.sensor is not None for term in terms)
    if tracked != bool(tables.targets):
        if tracked:
            return 'a term of kind "tracking" needs a target: add a table [[targets]]'
        return 'targets needs a term that tracks: add a term of kind "tracking" to objective.terms'
    return _same_name("robots", tables.robots) or _dynamics_fault(tables)


def _fault_of_robot(terms: Sequence[Term], robot: Robot, number: int) -> str | None:
    """Return a message if the terms of one robot are inconsistent."""
    key, weights = f"robots[{number}]", robot.weights
    if weights and len(weights) != len(terms):
        return (
            f"{key}.weights has {len(weights)} numbers for {len(terms)} objective.terms: give one "
            "number for each term, and 0 for a term that does not apply to this robot"
        )
    own = [t for t, w in zip(terms, weights, strict=True) if w > 0.0] if weights else list(terms)
    if not own:
        return f"{key}.weights has only zeros: give at least one term a weight above 0"
    if any(term.steers == "goal" for term in own) and robot.goal_m is None:
        return f'a term of kind "goal" needs {key}.goal_m: write goal_m = [x, y] in metres'
    if weights and robot.goal_m is not None and not any(term.steers == "goal" for term in own):
        return (
            f'{key}.goal_m needs a term of kind "goal" with a weight above 0: increase the weight '
            f"in {key}.weights, or leave goal_m out"
        )
    if sum(term.steers is not None for term in own) > 1:
        return (
            f'{key} has several terms of kind "goal" or "until_connected" or form "two_layer", but '
            f"only one may steer it: leave the others out, or give them weight 0 in {key}.weights"
        )
    return None


def _dynamics_fault(tables: ProblemFile) -> str | None:
    """Return a message if the settings do not support the dynamics of the robots."""
    for number, robot in enumerate(tables.robots):
        dynamics = robot.dynamics
        if robot.moves_freely:
            continue
        if not planner_kind(tables.planner.name).has_dynamics:
            return (
                f'planner.name is "{tables.planner.name}", which supports only the dynamics '
                f'"single_integrator", but robots[{number}] has "{dynamics.kind}": use '
                f"{names_with('has_dynamics')}"
            )
        turn_rad_s = dynamics.turn_rate_max_rad_s if isinstance(dynamics, Unicycle) else 0.0
        turn_rad = turn_rad_s * tables.planner.step_s
        if turn_rad > MOST_TURN_RAD:
            return (
                f"robots[{number}].turn_rate_max_rad_s allows a turn of {turn_rad:.3g} rad per "
                "step, more than a full circle: reduce it or planner.step_s"
            )
    return None


def _same_name(table: str, entries: Sequence[Robot] | Sequence[MovingObstacle]) -> str | None:
    """Return a message if two entries of a table have the same name."""
    names = [entry.name for entry in entries]
    for number, name in enumerate(names):
        if names.index(name) < number:
            return (
                f"{table}[{number}].name is {name!r}, the same as "
                f"{table}[{names.index(name)}].name: give each its own name"
            )
    return None


SCHEMA_VERSION = 1

MAX_STATIONS = 20  # Maximum number of stations, since each has its own channel fit and posterior


class HeadTable(Table):
    """Table ``[problem]``: name and task of the problem."""

    schema_version: Literal[1] = Field(alias="schema")
    """Version of this schema; it is 1."""
    name: Name
    """Name: letters, digits, '_' and '-'."""
    task: Name
    """Name of the task."""
    description: str = ""
    """Description in one sentence."""


class TaskFile(Table):
    """Base class of problem files: the tables common to all tasks."""

    problem: HeadTable
    report: ReportSettings = ReportSettings()


class ProblemTable(HeadTable):
    """Table ``[problem]``: name and task of the problem."""

    task: Task = "reach"  # pyright: ignore[reportIncompatibleVariableOverride]
    """Task of the robots: reach a goal, track a target, learn the path loss, map the channel,
    connect after a short path, or custom (defined by registered terms)."""


class ProblemFile(Table):
    """Problem file (TOML) of motion planning."""

    problem: ProblemTable
    world: Annotated[Workspace, WORLD]
    channel: ChannelSetup
    robots: tuple[Robot, ...] = Field(strict=False, min_length=1, max_length=20)
    """List of robots; each needs a goal for the task reach."""
    stations: tuple[BaseStation, ...] = Field(strict=False, min_length=1, max_length=MAX_STATIONS)
    """Fixed base stations; a robot is connected if the power of any one reaches its threshold."""
    targets: tuple[Target, ...] = Field(default=(), strict=False, max_length=1)
    """List with the target, for the task track."""
    objective: Annotated[ReachObjective | TermsObjective, OBJECTIVE] = Field(
        default_factory=ReachObjective
    )
    constraints: Constraints = Field(default_factory=Constraints)
    planner: PlannerSettings
    report: ReportSettings = ReportSettings()
    compare: ComparisonSettings | None = None

    @model_validator(mode="before")
    @classmethod
    def _common_log(cls, tables: Any) -> Any:
        """Make the first log of a station the common log if there is none."""
        try:
            logs = [each["log_file"] for each in tables["stations"] if "log_file" in each]
            channel = {"measurements": {}} | tables.get("channel", {})
            if isinstance(logs[0], str) and not {"file", "count"} & channel["measurements"].keys():
                channel["measurements"] = {"file": logs[0]} | channel["measurements"]
                return {**tables, "channel": channel}
        except (AttributeError, IndexError, KeyError, TypeError):
            pass  # The fields' own validation reports it
        return tables

    @model_validator(mode="after")
    def _fits_the_task(self) -> ProblemFile:
        fault = _reach_fault(self) if self.problem.task == "reach" else _terms_fault(self)
        fault = fault or _same_name("world.moving", self.world.moving)
        if fault is not None:
            raise fault_of(fault)
        return self


def json_schema(model: type[Table] = ProblemFile) -> dict[str, Any]:
    """Return the JSON schema of problem files (draft 2020-12) that ``planopt schema`` prints."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema()}
