"""Read the tables of a TOML file, or say in which line it is wrong."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from planopt.errors import InputError
from planopt.files.reading import read_text

LARGEST_TOML_BYTES = 2 * 2**20
"""Size limit of problem files; obstacles and maps have files of their own."""

FILE_KEYS = ("file", "gain_file", "log_file")
"""Keys of a problem file that name other files."""

DEEP_KEY = re.compile(r"(?<![\w\"'-])(?:[\w\"'-]+[ \t]*\.[ \t]*){20}")
"""A dotted key of so many parts, which the parser takes quadratic time for."""


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of the TOML file `path`."""
    text = read_text(path, LARGEST_TOML_BYTES)
    deep = DEEP_KEY.search(text)
    if deep is not None:
        row = text.count("\n", 0, deep.start()) + 1
        raise InputError(
            "is not TOML of tables: a key is nested too deeply",
            file=path,
            row=row,
            remedy="write tables as [table] or [[table]]",
        )
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(
            "is not TOML: nested too deeply",
            file=path,
            remedy="write tables as [table] or [[table]]",
        ) from None
    except ValueError as error:  # TOMLDecodeError, and integers too long for Python
        raise _parse_error(str(error), text, path) from None


def named_files(value: object) -> tuple[str, ...]:
    """Return the names of other files in the tables of a problem file, each once."""
    found: list[str] = []
    if isinstance(value, Mapping):
        for key, part in cast("Mapping[str, object]", value).items():
            if key in FILE_KEYS and isinstance(part, str):
                found.append(part)
            else:
                found += named_files(part)
    elif isinstance(value, list):
        for part in cast("list[object]", value):
            found += named_files(part)
    return tuple(dict.fromkeys(found))


def _parse_error(message: str, text: str, path: Path) -> InputError:
    """The parser's message with its line number as the row."""
    found = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", message)
    row, remedy = None, None
    if found is not None:
        message = message[: found.start()]
        row = int(found[1]) if found[1] else len(text.splitlines())
        remedy = f"at column {found[2]}" if found[2] else "at the end of the file"
    elif "int_max_str_digits" in message:
        message, remedy = "an integer has thousands of digits", "write a number of a few digits"
    return InputError(f"is not TOML: {message}", file=path, row=row, remedy=remedy)
