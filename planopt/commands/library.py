"""``planopt list`` and ``planopt schema``: what problems there are, and how they are written."""

from __future__ import annotations

from planopt.commands.options import JsonOption
from planopt.commands.output import show


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


def schema(json: JsonOption = False) -> int:
    """Print the JSON schema of problem files; --json prints it on one line."""
    from json import dumps

    from planopt.problems.schema import json_schema

    definition = json_schema()
    show(json, definition, dumps(definition, indent=2))
    return 0
