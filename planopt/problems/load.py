"""Load problems from files or by name, and write them as plain tables that can be read back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from planopt.errors import InputError, require_text
from planopt.keys import saved
from planopt.problems.channel_setup import (
    ArrayTruth,
    ChannelSetup,
    FunctionTruth,
    GivenParameters,
    LoggedMeasurements,
    RasterTruth,
    SampledMeasurements,
    log_of,
    raster_truth_of,
)
from planopt.problems.library import find_problem, read_toml
from planopt.problems.objective import ReachObjective, TermsObjective, term_keys
from planopt.problems.problem import Problem, problem_from_tables, tables_of
from planopt.problems.robot import Robot
from planopt.problems.tasks import MOTION, problem_from
from planopt.problems.world_tables import world_table
from planopt.world.raster_files import raster_ending
from planopt.world.workspace import Workspace


def check_files(problem: Problem) -> None:
    """Raise an error for a file that the problem needs for simulation and that is not there.

    Apart from :func:`planopt.problems.checks.check`, because a saved plan can be judged without
    these files.
    """
    truth, measurements = problem.channel.truth, problem.channel.measurements
    none_taken = isinstance(measurements, SampledMeasurements) and measurements.count == 0
    if none_taken and not _is_known(problem.channel.given):
        raise InputError(
            "is 0, should be greater than or equal to 1",
            file=problem.file,
            key="channel.measurements.count",
            remedy="take some, give the file of a log, or all of channel.fit.given",
        )
    for number, radio in enumerate(problem.stations):
        if isinstance(truth, RasterTruth):
            own = radio.gain_file is not None
            key = f"stations[{number}].gain_file" if own else "channel.truth.file"
            _check_map(problem, raster_truth_of(truth, radio).file, key)
        if isinstance(measurements, LoggedMeasurements):
            own = radio.log_file is not None
            key = f"stations[{number}].log_file" if own else "channel.measurements.file"
            _check_file(problem, log_of(measurements, radio).file, key)


def _is_known(given: GivenParameters | None) -> bool:
    """Return whether nothing of the channel's parameters is left to be estimated."""
    return given is not None and given.k_pl_db is not None


def _check_map(problem: Problem, path: Path, key: str) -> None:
    _check_file(problem, path, key)
    try:
        raster_ending(path)
    except InputError as error:
        raise InputError(error.message, file=problem.file, key=key, remedy=error.remedy) from error


def _check_file(problem: Problem, path: Path, key: str) -> None:
    try:
        there = path.is_file()
    except OSError:  # a name that the file system does not allow
        there = False
    if not there:
        raise InputError(
            f"{path} is not a file",
            file=problem.file,
            key=key,
            remedy="file names are relative to the problem file",
        )


def load(path_or_name: Path | str) -> Any:
    """Load a problem of any task.

    Parameters
    ----------
    path_or_name
        The path of a TOML file, or the name of a library problem such as ``munich_courier``.

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
    """Load a problem of motion planning; parameters and errors as :func:`load`."""
    problem = load(path_or_name)
    if isinstance(problem, Problem):
        return problem
    raise InputError(
        f"is {problem.task}, which is no motion planning",
        file=problem.file,
        key="problem.task",
        remedy=f"name a problem with one of the tasks {', '.join(MOTION)}",
    )


def problem_to_dict(problem: Problem) -> dict[str, Any]:
    """`problem` as JSON-serialisable tables; :func:`problem_from_dict` reads them.

    Keys that have no value are left out, as they are in a problem file.
    """
    return {key: saved_table(part) for key, part in tables_of(problem).items()}


def saved_table(part: Any) -> Any:
    """Return a part of a problem as its table, or several of them as an array of tables."""
    match part:
        case Workspace():
            return world_table(part)
        case ChannelSetup():
            return saved(_without_python(part))
        case ReachObjective():
            return saved(part)
        case TermsObjective():
            return {"terms": [term_keys(term) for term in part.terms]}
        case Robot(dynamics=dynamics) if not (part.moves_freely or "dynamics" in part.to_keys()):
            raise InputError(
                f"{dynamics.kind} is from Python and cannot be saved",
                key="robots.dynamics",
                remedy="use the plans and runs in Python",
            )
        case tuple():
            return [saved_table(each) for each in cast("tuple[Any, ...]", part)]
        case _:
            return saved(part)


def problem_from_dict(data: Mapping[str, Any], *, file: Path | None = None) -> Problem:
    """The problem that :func:`problem_to_dict` wrote, validated as a problem file is.

    Parameters
    ----------
    data
        The tables, for instance from ``json.load``.
    file
        Where they came from, for messages; relative file names in them start at its folder.

    Raises
    ------
    InputError
        As for a problem file, except that the truth's map and the log need not be there.
    """
    folder = Path.cwd() if file is None else file.absolute().parent
    return problem_from_tables(data, folder=folder, file=file)


def _without_python(channel: ChannelSetup) -> ChannelSetup:
    """Return the channel without a truth from Python, nor measurements to be taken from it."""
    if not isinstance(channel.truth, ArrayTruth | FunctionTruth):
        return channel
    logged = isinstance(channel.measurements, LoggedMeasurements)
    left = channel.measurements if logged else SampledMeasurements()
    return replace(channel, truth=None, measurements=left)
