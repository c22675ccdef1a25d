"""``planopt list`` and ``planopt schema``: what problems there are, and how they are written."""

from __future__ import annotations

from typing import Annotated

import typer

from planopt.commands.options import JsonOption
from planopt.commands.output import show
from planopt.errors import InputError


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
