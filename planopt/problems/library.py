"""The problem library: the files of the folder ``problems`` that come with the package."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from planopt.errors import InputError, path_of
from planopt.problems.read_toml import read_toml

SUFFIX = ".toml"


@dataclass(frozen=True)
class LibraryEntry:
    """One problem of the library."""

    name: str  # What :func:`planopt.problems.load.load` takes
    description: str  # For people
    path: Path  # Its file
    task: str  # What it asks for


def library_folder() -> Path:
    """Return the library's folder: beside this file if installed, else in the checkout."""
    here = Path(__file__).parent
    installed = here / "library"
    return installed if installed.is_dir() else here.parents[1] / "problems"


def list_problems() -> tuple[LibraryEntry, ...]:
    """Every problem of the library, sorted by name.

    Raises
    ------
    InputError
        A file of the library does not parse or has no ``[problem]`` table with a description.
    """
    return tuple(
        LibraryEntry(path.stem, _text(path, "description", ""), path, _text(path, "task", "reach"))
        for path in sorted(library_folder().glob(f"*{SUFFIX}"))
    )


def find_problem(path_or_name: Path | str) -> Path:
    """The file of a problem given by path or by library name."""
    path = path_of("path_or_name", path_or_name, "give the path or name of a problem")
    try:
        if path.is_file():
            return path
        named = library_folder() / f"{path.name}{SUFFIX}"
        is_name = path.name == str(path_or_name) and path.suffix != SUFFIX
        if is_name and named.is_file():
            return named
        is_folder = path.is_dir()
    except OSError:  # a name that the file system does not allow
        is_name = is_folder = False
    if is_folder:
        raise InputError("is a folder, not a problem file", file=path, remedy="name its .toml file")
    from planopt.problems.messages import nearest  # loads pydantic

    known = [entry.stem for entry in library_folder().glob(f"*{SUFFIX}")]
    if is_name:
        raise InputError(
            f"no file and no library problem is called {str(path_or_name)!r}",
            remedy=nearest(path.name, known),
        )
    raise InputError("there is no such file", file=path, remedy=nearest(path.stem, known))


def _text(path: Path, key: str, default: str) -> str:
    """Return a text of ``[problem]``, without the seconds that validating all of it takes."""
    head: Any = read_toml(path).get("problem")
    # Not even a table: the error below names the key.
    tables = cast("dict[str, Any]", head if isinstance(head, dict) else {key: None})
    text = tables.get(key, default)
    if not isinstance(text, str):
        raise InputError(
            "is missing or no text", file=path, key=f"problem.{key}", remedy="one sentence"
        )
    return text
