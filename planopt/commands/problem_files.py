"""``planopt list``, ``schema``, ``init``, ``show`` and ``validate``: problems and their files."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planopt.commands.options import JsonOption, ProblemArgument
from planopt.commands.output import progress, results_folder, show
from planopt.errors import InputError, NoPlanError, OutputError

if TYPE_CHECKING:
    from planopt.problems.problem import Problem


def list_problems(json: JsonOption = False) -> int:
    """List the problem library."""
    from planopt.problems.library import list_problems as entries_of_library

    entries = entries_of_library()
    data = {
        "problems": [
            {"name": entry.name, "description": entry.description, "file": str(entry.path)}
            for entry in entries
        ]
    }
    width = max((len(entry.name) for entry in entries), default=0)
    text = "\n".join(f"{entry.name:{width}}  {entry.description}" for entry in entries)
    show(json, data, text)
    return 0


def schema(
    task: Annotated[
        str | None,
        typer.Option("--task", metavar="NAME", help="A task with tables of its own."),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Print the JSON schema of problem files; --json prints it on one line."""
    from json import dumps

    from planopt.problems.load import SYSTEMS
    from planopt.problems.schema import json_schema
    from planopt.problems.systems import system_of

    system = system_of(task)
    if task is not None and system is None:
        raise InputError(
            f"{task!r} has no tables of its own",
            key="--task",
            remedy=f"one of {', '.join(SYSTEMS)}, or nothing for motion planning",
        )
    definition = json_schema() if system is None else json_schema(system.model)
    show(json, definition, dumps(definition, indent=2))
    return 0


def init(
    file: Annotated[
        Path, typer.Argument(metavar="FILE.toml", help="File to write; it must not exist.")
    ],
    source: Annotated[
        str, typer.Option("--from", metavar="NAME", help="A problem that `list` shows.")
    ] = "open_field",
    json: JsonOption = False,
) -> int:
    """Begin a problem file: a copy of one of the library, with the maps that it names."""
    from planopt.files.regular import read_bytes
    from planopt.files.whole import write_whole
    from planopt.problems.library import library_folder, list_problems
    from planopt.problems.read_toml import named_files, read_toml

    library = {entry.name: entry.path for entry in list_problems()}
    if source not in library:
        raise InputError(
            f"no library problem is called {source!r}",
            key="--from",
            remedy=f"one of {', '.join(library)}",
        )
    if file.suffix != ".toml":
        raise InputError("is no name of a problem file", file=file, remedy="end it in .toml")
    contents = {file: read_bytes(library[source])}
    for name in named_files(read_toml(library[source])):
        contents[file.parent / name] = read_bytes(library_folder() / name)
    # The same map may be there for another problem.
    written = [path for path, content in contents.items() if not _has(path, content)]
    for path in written:
        if path.exists():
            raise OutputError(f"{path}: is there already (choose another folder or name)")
    with contextlib.ExitStack() as stack:
        for folder in sorted({path.parent for path in written}):
            stack.enter_context(results_folder(folder))
        # The problem is written last, after the files that it names.
        for path in reversed(written):
            write_whole(path, lambda temporary, path=path: _write(temporary, contents[path]))
    data = {"problem": str(file), "files": [str(path) for path in contents]}
    text = [f"{path}: written" for path in written]
    show(json, data, "\n".join([*text, f"next: planopt show {file}, planopt solve {file}"]))
    return 0


def show_problem(problem: ProblemArgument, json: JsonOption = False) -> int:
    """Print what a problem file says; --json prints all of it, with every default."""
    from planopt.problems.save import problem_to_dict
    from planopt.problems.systems import SystemProblem, load_any

    found = load_any(problem)
    if isinstance(found, SystemProblem):
        lines = found.system.words(found)
        show(json, found.tables() if json else {}, "\n".join(lines))
        return 0
    from planopt.problems.plausibility import problem_warnings

    warnings = [f"  warning     {warning}" for warning in problem_warnings(found)]
    text = "\n".join([problem_in_words(found), *warnings])
    show(json, problem_to_dict(found) if json else {}, text)
    return 0


def validate(problem: ProblemArgument, json: JsonOption = False) -> int:
    """Check a problem file, its maps and logs, and that the channel can be fitted."""
    from planopt.planning.learn import prepare
    from planopt.problems.plausibility import measured_warnings, problem_warnings
    from planopt.problems.systems import SystemProblem, load_any
    from planopt.studies.variants import default_seeds, settings_of

    found = load_any(problem)
    if isinstance(found, SystemProblem):
        show(json, {"problem": found.name, "valid": True}, f"{found.name}: valid")
        return 0
    if found.compare is not None:
        settings_of([found])
        default_seeds(found.compare)
    with progress("reading maps and logs"):
        prepared = prepare(found, 0)
        warnings = [*problem_warnings(found), *_unreachable(found)]
    beliefs = (prepared.belief, *prepared.belief.further)
    for belief in beliefs:
        warnings += measured_warnings(belief.posterior.measurements)
        warnings += [f"fit of the channel, seed 0: {words}" for words in belief.fit.warnings]
    count = sum(belief.fit.measurements for belief in beliefs)
    data = {"problem": found.name, "valid": True, "measurements": count, "warnings": warnings}
    lines = [
        f"{found.name}: valid, {count} measurements",
        *(f"  {warning}" for warning in warnings),
    ]
    show(json, data, "\n".join(lines))
    return 0


def _unreachable(problem: Problem) -> list[str]:
    """Return a warning if obstacles cut a goal off."""
    from planopt.planning.scene import build_scenes

    try:
        build_scenes(problem)
    except NoPlanError as error:
        return [str(error)]
    return []


def problem_in_words(problem: Problem) -> str:
    """Return a problem in lines of text."""
    planner, workspace, limits = problem.planner, problem.workspace, problem.constraints
    west, south, east, north = workspace.bounds_m
    truth, measured = problem.channel.truth, problem.channel.measurements
    source = getattr(truth, "file", None)
    kind = "drawn" if source is None else f"of {source}"
    count = getattr(measured, "count", None)
    first = f"of {getattr(measured, 'file', None)}" if count is None else str(count)
    lines = [
        f"{problem.name}: {problem.description}",
        f"  task        {problem.task}, horizon {planner.horizon}, steps of {planner.step_s:g} s, "
        f"at most {planner.max_steps}",
        f"  world       {east - west:g} x {north - south:g} m, "
        f"{len(workspace.obstacles)} obstacles, {len(workspace.moving)} moving"
        + (f", {len(workspace.timed)} that come or go" if workspace.timed else ""),
        f"  channel     {'none to simulate' if truth is None else kind}; measurements {first}",
    ]
    for radio in problem.stations:
        x, y = radio.site.position_m
        lines.append(
            f"  station     {radio.name} at ({x:g}, {y:g}) m, connected from "
            f"{radio.threshold_dbm:g} dBm"
        )
    for robot in problem.robots:
        goal = "" if robot.goal_m is None else " to ({:g}, {:g}) m".format(*robot.goal_m)
        lines.append(
            "  robot       {} from ({:g}, {:g}) m{}, at most {:g} m/s".format(
                robot.name, *robot.start_m, goal, robot.speed_max_m_s
            )
        )
    if limits.asks_connection:
        lines.append(f"  asked       P(connected) at least {limits.p_min:g}")
    lines.append(f"  clearance   {limits.clearance_m:g} m")
    return "\n".join(lines)


def _has(path: Path, content: bytes) -> bool:
    from planopt.files.regular import read_bytes

    return path.is_file() and read_bytes(path) == content


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)
