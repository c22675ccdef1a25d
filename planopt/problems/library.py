"""Problem library, and the reader of problem files in TOML."""

import difflib
import json
import os
import re
import tomllib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from planopt.errors import InputError, path_of
from planopt.files.reading import PRIVATE, data_folder, read_text

LARGEST_TOML_BYTES = 2 * 2**20
"""Size limit of problem files in bytes; obstacles and maps have their own files."""
FILE_KEYS = ("file", "gain_file", "log_file")  # Keys of a problem file that refer to other files
DEEP_KEY = re.compile(r"(?<![\w\"'-])(?:[\w\"'-]+[ \t]*\.[ \t]*){20}")
"""Pattern of dotted keys with 20 or more parts, for which the parser takes quadratic time."""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file."""
    text = read_text(path, LARGEST_TOML_BYTES)
    deep = DEEP_KEY.search(text)
    if deep is not None:
        row = text.count("\n", 0, deep.start()) + 1
        raise InputError(
            "the keys are nested too deeply",
            file=path,
            row=row,
            remedy="use [table] and [[table]] for tables",
        )
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(
            "has values that are nested too deeply",
            file=path,
            remedy="use [table] and [[table]] for tables",
        ) from None
    except ValueError as error:  # TOMLDecodeError, or integers too long for Python
        message, row, remedy = str(error), None, None
        found = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", message)
        if found is not None:
            message = message[: found.start()]
            row = int(found[1]) if found[1] else len(text.splitlines())
            remedy = f"at column {found[2]}" if found[2] else "at the end of the file"
        elif "int_max_str_digits" in message:
            message, remedy = "an integer has thousands of digits", "write a number of a few digits"
        raise InputError(f"invalid TOML: {message}", file=path, row=row, remedy=remedy) from None


def named_files(value: object) -> tuple[str, ...]:
    """Return the files to which a problem file refers, except those in `DATA_FOLDER`."""
    found: list[str] = []
    if isinstance(value, Mapping):
        for key, part in cast("Mapping[str, object]", value).items():
            if key in FILE_KEYS and isinstance(part, str):
                found += [] if part.startswith(PRIVATE) else [part]
            else:
                found += named_files(part)
    elif isinstance(value, list):
        for part in cast("list[object]", value):
            found += named_files(part)
    return tuple(dict.fromkeys(found))


SUFFIX = ".toml"

FAMILIES = "families.json"  # File of the library that classifies its problems, one per line


@dataclass(frozen=True)
class Classification:
    """Place of a problem in the test set."""

    family: str = ""  # Difficulty that the problem tests, such as "narrow gaps"
    difficulty: str = ""  # easy, medium or hard
    provenance: str = ""  # Source of scene and channel


@dataclass(frozen=True)
class LibraryEntry:
    """Entry of the problem library."""

    name: str  # Argument of :func:`planopt.problems.load.load`
    description: str  # Description in one sentence
    path: Path  # Problem file
    task: str  # Task of the problem
    lacks_data: bool = False  # True if its measurements need `DATA_FOLDER`, which is not set
    test: Classification = Classification()


def library_folder() -> Path:
    """Return the folder of the library: next to this file if installed, else in the checkout."""
    here = Path(__file__).parent
    installed = here / "library"
    return installed if installed.is_dir() else here.parents[1] / "problems"


def list_problems() -> tuple[LibraryEntry, ...]:
    """Return every problem of the library, sorted by name.

    Raises
    ------
    InputError
        A library file cannot be parsed or has no table ``[problem]`` with a description.
    """
    is_set, tests = data_folder() is not None, classifications()
    return tuple(
        LibraryEntry(
            path.stem,
            _text(path, "description", ""),
            path,
            _text(path, "task", "reach"),
            lacks_data=not is_set and PRIVATE in read_text(path, LARGEST_TOML_BYTES),
            test=tests[path.stem],
        )
        for path in sorted(library_folder().glob(f"*{SUFFIX}"))
    )


def classifications() -> defaultdict[str, Classification]:
    """Return the test-set classification of each library problem, by name of the problem."""
    file, found = library_folder() / FAMILIES, defaultdict[str, Classification](Classification)
    if not file.is_file():
        return found
    try:
        rows = json.loads(read_text(file))
        return found | {row.pop("problem"): Classification(**row) for row in rows}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            "is damaged", file=file, remedy="restore the file from the repository"
        ) from None


def find_problem(path_or_name: Path | str) -> Path:
    """Return the problem file for a path or a library name."""
    path = path_of("path_or_name", path_or_name, "give the path or name of a problem")
    try:
        if path.is_file():
            return path
        named = library_folder() / f"{path.name}{SUFFIX}"
        is_name = path.name == str(path_or_name) and path.suffix != SUFFIX
        if is_name and named.is_file():
            return named
        is_folder = path.is_dir()
    except OSError:  # Name not allowed by the file system
        is_name = is_folder = False
    if is_folder:
        raise InputError(
            f"{str(path)!r} is a folder, not a problem file", remedy="give the .toml file in it"
        )
    known = sorted(entry.stem for entry in library_folder().glob(f"*{SUFFIX}"))
    # The run time of the comparison is quadratic in the length.
    close = difflib.get_close_matches(path.stem[:100], known)
    remedy = "`planopt list` names all problems of the library"
    if close:
        remedy = f"did you mean {' or '.join(close)}? {remedy}"
    if is_name:
        raise InputError(
            f"there is neither a file nor a library problem named {str(path_or_name)!r}",
            remedy=remedy,
        )
    fault = "is no ordinary file" if os.path.lexists(path) else "does not exist"
    raise InputError(fault, file=path, remedy=remedy)


def _text(path: Path, key: str, default: str) -> str:
    """Return a text value of ``[problem]`` without the slow validation of the whole file."""
    head: Any = read_toml(path).get("problem")
    # If this is not a table, the error below names the key.
    tables = cast("dict[str, Any]", head if isinstance(head, dict) else {key: None})
    text = tables.get(key, default)
    if not isinstance(text, str):
        raise InputError(
            "is missing, or is not text",
            file=path,
            key=f"problem.{key}",
            remedy="give one sentence in quotes",
        )
    return text
