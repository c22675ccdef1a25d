"""``planopt list``, ``schema``, ``init``, ``show`` and ``validate``: problems and their files."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from planopt.commands.options import JsonOption, ProblemArgument, progress, results_folders, show
from planopt.errors import InputError, OutputError


def list_problems(json: JsonOption = False) -> int:
    """List the problem library by family."""
    from dataclasses import asdict

    from planopt.files.reading import DATA_FOLDER
    from planopt.problems.library import list_problems as entries_of_library

    entries = entries_of_library()
    data = [
        {
            "name": entry.name,
            "description": entry.description,
            "file": str(entry.path),
            **asdict(entry.test),
        }
        for entry in entries
    ]
    width = max((len(entry.name) for entry in entries), default=0)
    lines: list[str] = []
    for family in dict.fromkeys(entry.test.family for entry in entries):
        lines.append(f"{family or 'other'}:")
        lines += [
            f"  {entry.name:{width}}  {entry.description}"
            + (f" Needs data in {DATA_FOLDER}." if entry.lacks_data else "")
            for entry in entries
            if entry.test.family == family
        ]
    lines.append("plan one: planopt solve NAME --out plan (pursuits: planopt simulate NAME)")
    show(json, {"problems": data}, "\n".join(lines))
    return 0


def schema(
    task: Annotated[
        str | None, typer.Option("--task", metavar="NAME", help="Task; default: motion planning.")
    ] = None,
    json: JsonOption = False,
) -> int:
    """Print the JSON schema of problem files."""
    from json import dumps

    from planopt.problems.schema import json_schema
    from planopt.problems.tasks import MOTION, TASKS, task_named

    if task is not None and task not in TASKS.names():
        raise InputError(
            f"is {task!r}, which is not a task",
            key="--task",
            remedy=f"use one of {', '.join(TASKS.names())}",
        )
    is_motion = task is None or task in MOTION
    definition = json_schema() if is_motion else json_schema(task_named(task).model)
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
    """Copy a library problem and its maps to a new problem file."""
    from planopt.files.reading import read_bytes
    from planopt.files.writing import write_whole
    from planopt.problems.library import library_folder, list_problems, named_files, read_toml

    library = {entry.name: entry.path for entry in list_problems()}
    if source not in library:
        raise InputError(
            f"is {source!r}, which is not a problem of the library",
            key="--from",
            remedy=f"use one of {', '.join(library)}",
        )
    if file.suffix != ".toml":
        raise InputError(
            "is not a name for a problem file", file=file, remedy="use a name that ends in .toml"
        )
    contents = {file: read_bytes(library[source])}
    for name in named_files(read_toml(library[source])):
        contents[file.parent / name] = read_bytes(library_folder() / name)
    # Another problem may already have brought the same map.
    written = [
        path
        for path, content in contents.items()
        if not path.is_file() or read_bytes(path) != content
    ]
    for path in written:
        if path.exists():
            raise OutputError(f"{path} already exists (choose another folder or name)")
    with results_folders(sorted({path.parent for path in written})):
        # The problem is written last, after the files that it refers to.
        for path in reversed(written):
            write_whole(path, partial(Path.write_bytes, data=contents[path]))
    data = {"problem": str(file), "files": [str(path) for path in contents]}
    text = [f"{path}: written" for path in written]
    verb = "simulate" if read_toml(library[source])["problem"].get("task") == "pursuit" else "solve"
    show(json, data, "\n".join([*text, f"next: planopt show {file}, planopt {verb} {file}"]))
    return 0


def show_problem(problem: ProblemArgument, json: JsonOption = False) -> int:
    """Print a problem file; --json prints all keys with defaults."""
    from planopt.problems.load import load
    from planopt.problems.tasks import task_of

    found = load(problem)
    task = task_of(found)
    show(json, task.tables(found) if json else {}, "" if json else "\n".join(task.words(found)))
    return 0


def validate(problem: ProblemArgument, json: JsonOption = False) -> int:
    """Check a problem file, its maps and logs, and fit the channel."""
    from planopt.problems.load import load
    from planopt.problems.tasks import task_of

    found = load(problem)
    with progress("reading maps and logs"):
        more = task_of(found).validated(found)
    data = {"problem": found.name, "valid": True, **more}
    count = f", {more['measurements']} measurements" if "measurements" in more else ""
    warnings = [f"  {warning}" for warning in more.get("warnings", ())]
    show(json, data, "\n".join([f"{found.name}: valid{count}", *warnings]))
    return 0
