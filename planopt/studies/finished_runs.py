"""Record of finished runs, so that a study that was stopped does not repeat them.

Each run has a file, named by a digest of all that decides its result: the problem with the content
of the files that it names, the seed, and the program. A run is written when it is finished, whole,
by whichever process drove it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar, cast

from planopt.errors import InputError
from planopt.files.regular import read_bytes, read_text
from planopt.files.typed_json import decoded, encoded
from planopt.files.whole import remove_remains, strict_text, write_text
from planopt.problems.problem import Problem
from planopt.problems.read_toml import FILE_KEYS
from planopt.problems.save import problem_to_dict

LIBRARIES = ("casadi", "clarabel", "numpy", "scipy", "shapely")
"""Packages whose version may change a result."""

Value = TypeVar("Value")


@dataclass(frozen=True)
class FinishedRuns:
    """A folder of finished runs.

    Attributes
    ----------
    folder
        Made when the first run is kept.
    """

    folder: Path

    def find(self, key: Mapping[str, Any], kind: type[Value]) -> Value | None:
        """Return the result that was kept for `key`, or None: of another type, or damaged."""
        try:
            record = json.loads(read_text(self._file(key)))
            if record["key"] != key:
                return None
            return decoded(kind, record["result"])
        except (InputError, ValueError, KeyError, TypeError, RecursionError):
            return None

    def all(self, kind: type[Value]) -> list[Value]:
        """Return every result of a type that is kept, whatever its key; damaged ones left out."""
        found: list[Value] = []
        for file in sorted(self.folder.glob("*.json")):
            try:
                found.append(decoded(kind, json.loads(read_text(file))["result"]))
            except (InputError, ValueError, KeyError, TypeError, RecursionError):
                continue
        return found

    def keep(self, key: Mapping[str, Any], result: object) -> None:
        """Keep a result, whole or not at all.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        write_text(self._file(key), strict_text({"key": key, "result": encoded(result)}))

    def tidy(self) -> None:
        """Remove what processes left that were killed while they kept a result."""
        remove_remains(self.folder)

    def _file(self, key: Mapping[str, Any]) -> Path:
        return self.folder / f"{_digest(strict_text(key).encode())[:32]}.json"


def run_key(problem: Problem | Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Return all that decides a run: problem, seed and program.

    Parameters
    ----------
    problem
        With the settings of the run; or its tables.
    seed
        Of everything drawn.

    Raises
    ------
    InputError
        A file that the problem names cannot be read, or the problem has parts from Python.
    """
    tables = problem_to_dict(problem) if isinstance(problem, Problem) else problem
    return {"problem": _deciding(tables), "seed": seed, "program": dict(program())}


def digest_of_tables(tables: Mapping[str, Any]) -> str:
    """Return a digest of all that decides what a problem is, the content of its files included."""
    return _digest(strict_text(_deciding(tables)).encode())


def _deciding(tables: Mapping[str, Any]) -> Any:
    """The tables of a problem without those of its pictures, and with the content of its files."""
    return _with_contents({key: table for key, table in tables.items() if key != "report"})


def _with_contents(value: Any, name: str = "") -> Any:
    """`value` with digests in place of the names of files, whose contents decide the result."""
    if isinstance(value, Mapping):
        table = cast("Mapping[str, Any]", value)
        return {key: _with_contents(part, key) for key, part in table.items()}
    if isinstance(value, list | tuple):
        return [_with_contents(part) for part in cast("list[Any]", value)]
    if name in FILE_KEYS and isinstance(value, str):
        return _digest(read_bytes(Path(value)))
    return value


@cache
def program() -> tuple[tuple[str, str], ...]:
    """Return versions, and a digest of the source: a checkout changes without its version."""
    package = Path(__file__).parents[1]
    source = b"".join(path.read_bytes() for path in sorted(package.rglob("*.py")))
    return (
        ("planopt", version("planopt")),
        ("source", _digest(source)),
        *((name, version(name)) for name in LIBRARIES),
    )


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
