"""Problem input and output: files, library names, overrides of single keys, and tables."""

import re
from collections.abc import Mapping
from dataclasses import replace
from os.path import lexists
from pathlib import Path
from typing import Any, TypeVar, cast

from planopt.errors import InputError, require_text
from planopt.files.reading import DATA_FOLDER, PRIVATE, data_folder
from planopt.keys import saved
from planopt.parts import part_of
from planopt.problems.channel_setup import (
    ArrayTruth,
    ChannelSetup,
    FunctionTruth,
    LoggedMeasurements,
    MeasuredTruth,
    RasterTruth,
    SampledMeasurements,
    log_of,
    raster_truth_of,
)
from planopt.problems.library import find_problem, read_toml
from planopt.problems.objective import ReachObjective, TermsObjective, objective_keys
from planopt.problems.problem import Problem, check_problem, tables_of
from planopt.problems.robot import Robot
from planopt.problems.schema import world_table
from planopt.problems.settings import names_with, planner_kind
from planopt.problems.tasks import MOTION, TaskProblem, problem_from
from planopt.world.raster_files import raster_ending
from planopt.world.workspace import Workspace


def check_files(problem: Problem) -> None:
    """Raise an `InputError` if a file that simulation requires is missing."""
    truth, measurements = problem.channel.truth, problem.channel.measurements
    none_taken = isinstance(measurements, SampledMeasurements) and measurements.count == 0
    given = problem.channel.given
    if none_taken and (given is None or given.k_pl_db is None):
        raise InputError(
            "is 0, should be at least 1",
            file=problem.file,
            key="channel.measurements.count",
            remedy="give a count, a log file, or all parameters in channel.fit.given",
        )
    for number, radio in enumerate(problem.stations):
        if isinstance(truth, RasterTruth):
            own = radio.gain_file is not None
            key = f"stations[{number}].gain_file" if own else "channel.truth.file"
            _check_file(problem, raster_truth_of(truth, radio).file, key, is_map=True)
        if isinstance(truth, MeasuredTruth):
            _check_file(problem, log_of(truth.log, radio).file, "channel.truth.file")
        if isinstance(measurements, LoggedMeasurements):
            own = radio.log_file is not None
            key = f"stations[{number}].log_file" if own else "channel.measurements.file"
            _check_file(problem, log_of(measurements, radio).file, key)


def _check_file(problem: Problem, path: Path, key: str, *, is_map: bool = False) -> None:
    """Raise an `InputError` if a file is missing or a map file has an unknown extension."""
    try:
        there = path.is_file()
    except OSError:  # Name not allowed by the file system
        there = False
    if not there:
        folder = data_folder()
        is_private = path.is_relative_to(PRIVATE if folder is None else folder)
        raise InputError(
            f"is {path}, which {'is no ordinary file' if lexists(path) else 'does not exist'}",
            file=problem.file,
            key=key,
            remedy=f"set the environment variable {DATA_FOLDER} to the folder of these measurements"
            if is_private
            else "paths are relative to the folder of the problem file",
        )
    if is_map:
        try:
            raster_ending(path)
        except InputError as error:
            message, remedy = error.message, error.remedy
            raise InputError(message, file=problem.file, key=key, remedy=remedy) from error


def load(path_or_name: Path | str) -> Any:
    """Load a problem of any task.

    Parameters
    ----------
    path_or_name
        Path of a TOML file, or name of a library problem such as ``munich_courier``.

    Returns
    -------
    Problem or TaskProblem
        :class:`planopt.Problem` for motion planning, else a :class:`planopt.problems.TaskProblem`.
        Relative file names are resolved from the folder of the problem file.

    Raises
    ------
    InputError
        The file or problem does not exist or does not parse, a key is unknown or out of range, an
        obstacle is not a polygon, a named file is missing, or a start or goal is not free.

    Examples
    --------
    >>> import planopt
    >>> problem = planopt.load("munich_courier")
    >>> problem.task, problem.robots[0].goal_m
    ('reach', (-183.0, 89.0))
    """
    path = find_problem(path_or_name)
    require_text(str(path.absolute()), "the path")
    problem = problem_from(read_toml(path), folder=path.absolute().parent, file=path)
    if isinstance(problem, Problem):
        check_files(problem)
    return problem


def load_motion(path_or_name: Path | str) -> Problem:
    """Load a motion planning problem; see :func:`load` for parameters and errors."""
    problem = load(path_or_name)
    if isinstance(problem, Problem):
        return problem
    raise InputError(
        f"is {problem.task}, which is not a motion planning task",
        file=problem.file,
        key="problem.task",
        remedy=f"use a problem with one of the tasks {', '.join(MOTION)}",
    )


def problem_to_dict(problem: Problem | TaskProblem) -> dict[str, Any]:
    """Return `problem` as JSON-serialisable tables; :func:`problem_from_dict` reads them.

    Keys without a value are omitted, as in a problem file.
    """
    if isinstance(problem, TaskProblem):
        return problem.tables()
    return {key: saved_table(part) for key, part in tables_of(problem).items()}


def saved_table(part: Any) -> Any:
    """Return the table of a part of a problem, or an array of tables for several parts."""
    match part:
        case Workspace():
            return world_table(part)
        case ChannelSetup(truth=ArrayTruth() | FunctionTruth(), measurements=given):
            # Ground truth from Python, and measurements sampled from it, are left out.
            left = given if isinstance(given, LoggedMeasurements) else SampledMeasurements()
            return saved(replace(part, truth=None, measurements=left))
        case ReachObjective() | TermsObjective():
            return saved(objective_keys(part))
        case Robot(dynamics=dynamics) if not (part.moves_freely or "dynamics" in part.to_keys()):
            raise InputError(
                f"has the dynamics {dynamics.kind}, which are defined in Python and cannot be "
                "saved in a file",
                key="robots.dynamics",
                remedy="keep working with the plans and runs in Python",
            )
        case tuple():
            return [saved_table(each) for each in cast("tuple[Any, ...]", part)]
        case _:
            return saved(part)


def problem_from_dict(data: Mapping[str, Any], *, file: Path | None = None) -> Any:
    """Return the problem of any task in the tables of :func:`problem_to_dict`, validated.

    Parameters
    ----------
    data
        Tables of the problem, for instance from ``json.load``.
    file
        Source file, for messages; relative file names are resolved from its folder.

    Raises
    ------
    InputError
        Errors of a problem file, except for a missing ground-truth map or log.
    """
    folder = Path.cwd() if file is None else file.absolute().parent
    return problem_from(data, folder=folder, file=file)


AnyProblem = TypeVar("AnyProblem", bound=Problem | TaskProblem)

_PART = re.compile(r"(\w+)((?:\[(?:\d+|\*)\])*)")
"""Pattern of a part of a dotted key: a name with optional list indices."""


def with_overrides(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
) -> Problem:
    """Return a checked copy of `problem` with changed settings; None keeps the present value."""
    require_motion(problem)
    given = {
        name: value
        for name, value in (("horizon", horizon), ("planner", planner), ("cost-to-go", cost_to_go))
        if value is not None
    }
    try:
        changed = _overridden(problem, horizon, planner, cost_to_go)
        check_problem(changed)
    except InputError as error:
        if not given:
            raise
        check_problem(problem)
        settings = ", ".join(f"{name} {value}" for name, value in given.items())
        raise _of_change(error, settings) from None
    return changed


def require_motion(problem: Problem) -> None:
    """Raise an `InputError` if the argument is not a motion planning problem."""
    part_of("problem", problem, Problem, "use planopt.load, or create a Problem")


def _overridden(
    problem: Problem, horizon: int | None, planner: str | None, cost_to_go: str | None
) -> Problem:
    """Return a copy of `problem` with changed settings, each validated separately."""
    changes = {"horizon": horizon, "name": planner}
    changes = {name: value for name, value in changes.items() if value is not None}
    # The constructor of the changed part validates it.
    settings = replace(problem.planner, **changes) if changes else problem.planner
    if problem.has_goal and not planner_kind(settings.name).reaches_goals:
        raise InputError(
            f'is "{settings.name}", which cannot plan to a goal',
            key="planner.name",
            remedy=f"use {names_with('reaches_goals')} for the task reach",
        )
    changed = replace(problem, planner=settings) if changes else problem
    if horizon is not None and isinstance(problem.objective, TermsObjective):
        changed = replace(changed, objective=problem.objective.at_horizon(horizon))
    if cost_to_go is None:
        return changed
    if not problem.has_goal:
        raise InputError(
            f"applies only to the task reach, but the task of {problem.name} is {problem.task}",
            key="objective.cost_to_go",
            remedy="leave it out",
        )
    return replace(changed, objective=replace(problem.objective, cost_to_go=cost_to_go))


def with_changes(problem: AnyProblem, changes: Mapping[str, object]) -> AnyProblem:
    """Return a checked copy of `problem` with new values for the file keys in `changes`."""
    if not changes:
        return problem
    given = ", ".join(f"{key} = {value}" for key, value in changes.items())
    tables = problem.tables() if isinstance(problem, TaskProblem) else tables_of(problem)
    if not isinstance(problem, TaskProblem):
        # Parts without changes stay objects and are not validated again.
        for branch in {re.split(r"[.\[]", key)[0] for key in changes} & tables.keys():
            tables[branch] = saved_table(tables[branch])
    for key, value in changes.items():
        for table, name in _places(tables, key):
            table[name] = value
    try:
        changed = problem_from(tables, folder=Path.cwd(), file=None)
        if isinstance(problem, TaskProblem):
            return changed
        check_files(changed)
        return cast("AnyProblem", replace(changed, file=problem.file))
    except InputError as error:
        raise _of_change(error, given) from None


def _of_change(error: InputError, given: str) -> InputError:
    """Return the error about a changed problem, with the changes in its message."""
    message = f'{error.message}, in the setting "{given}"'
    return InputError(message, key=error.key, remedy=error.remedy)


def _places(tables: dict[str, Any], key: str) -> list[tuple[Any, str | int]]:
    """Return container and key (or index) of each value that a dotted key selects."""
    found: list[tuple[Any, str | int]] = [({"": tables}, "")]
    for part in key.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise InputError(
                "is not a key of a problem file",
                key=key or "''",
                remedy="write it like robots[0].speed_max_m_s",
            )
        found = [(_entered(table, name, key), match[1]) for table, name in found]
        for index in re.findall(r"\[(\d+|\*)\]", match[2]):
            entered: list[list[Any]] = []
            for table, name in found:
                value = table.get(name) if isinstance(name, str) else table[name]
                if not isinstance(value, list):
                    raise InputError(
                        f"has an index, but {name} is not a list",
                        key=key,
                        remedy=f"remove the index of {name}",
                    )
                entered.append(cast("list[Any]", value))
            found = [
                (entries, number)
                for entries in entered
                for number in (range(len(entries)) if index == "*" else (int(index),))
            ]
            if index != "*" and any(int(index) >= len(entries) for entries in entered):
                raise InputError(
                    f"has the index of a missing entry; the number of entries is {len(entered[0])}",
                    key=key,
                    remedy=f"give an index from 0 to {len(entered[0]) - 1}, or [*] for all",
                )
    return found


def _entered(table: Any, name: str | int, key: str) -> dict[str, Any]:
    """Return a table's subtable by name or index; a missing one is created."""
    value: Any = table.setdefault(name, {}) if isinstance(name, str) else table[name]
    if isinstance(value, list):
        raise InputError(
            f"needs an index, because {name} is a list",
            key=key,
            remedy=f"write {name}[0] for the first entry, or {name}[*] for all",
        )
    if not isinstance(value, dict):
        raise InputError(
            f"is not a key: {name} is not a table", key=key, remedy=f"remove the part after {name}"
        )
    return cast("dict[str, Any]", value)
