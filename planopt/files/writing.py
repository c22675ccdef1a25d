"""Atomic writing of result files and folders, strict JSON, and TOML with comments.

The JSON files of a folder, which every reader requires, are removed first and moved last: a process
that is killed in between leaves no result instead of a mixture of two.
"""

import contextlib
import json
import math
import os
import platform
import secrets
import shutil
import signal
import tempfile
from collections.abc import Callable, Generator, Iterator, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, cast

from planopt.errors import OutputError

STAGING = ".planopt-new-"  # Prefix of hidden files and folders that are still being written
Patterns = tuple[str, ...]
"""Names of all files that one kind of result may have, with * as wildcard."""


def hidden_name(suffix: str = "") -> str:
    """Return a new hidden name that identifies the writing process."""
    return f"{STAGING}{platform.node()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` on a temporary file next to `path`, then move the file into place."""
    # The name is fixed before the file exists, so that an interrupt cannot leave the file behind.
    temporary = path.parent / hidden_name(path.suffix)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` as UTF-8, atomically."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def strict_text(data: Mapping[str, Any]) -> str:
    """Return `data` as one line of strict JSON."""
    return json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n"


@contextlib.contextmanager
def replaced_results(folder: Path, files: Patterns, *, keep: bool = False) -> Generator[Path]:
    """Yield a folder for new results, which replace those in `folder` unless an error occurs."""
    # With `keep`, they are added to the existing results.
    staging = folder / hidden_name()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_remains(folder)
        staging.mkdir()
        yield staging
        names = sorted(os.listdir(staging), key=_is_head)
        unknown = [name for name in names if not _matches(name, files)]
        if unknown:
            raise ValueError(f"{unknown} are none of {files}")
        with _uninterrupted():
            for old in sorted(os.listdir(folder), key=_is_head, reverse=True):
                if not keep and _matches(old, files) and (_is_head(old) or old not in names):
                    (folder / old).unlink()
            for name in names:
                (staging / name).replace(folder / name)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    except OutputError as error:
        raise OutputError(str(error).replace(str(staging), str(folder))) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _matches(name: str, files: Patterns) -> bool:
    return any(fnmatch(name, pattern) for pattern in files)


def _is_head(name: str) -> bool:
    return name.endswith(".json")


@contextlib.contextmanager
def _uninterrupted() -> Generator[None]:
    """Delay interrupts while files are moved, if the system supports it."""
    if os.name != "posix":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def remove_remains(folder: Path) -> None:
    """Remove hidden files and folders left by killed processes of this machine."""
    own = f"{STAGING}{platform.node()}-"
    for path in folder.glob(f"{STAGING}*"):
        writer = path.name.removeprefix(own).partition("-")[0]
        if not writer.isdigit() or _is_running(int(writer)):
            continue
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _is_running(pid: int) -> bool:
    try:
        # On Windows, signal 0 would end the process.
        return os.name != "posix" or os.kill(pid, 0) is None
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True


def writable_folder(path: Path) -> Path:
    """Create the folder `path` if necessary and check that it is writable."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path):
            return path
    except OSError as error:
        fault = error.strerror or error
        hint = "(choose another --out)"
        raise OutputError(f"{path} is not a writable folder: {fault} {hint}") from error


Tables = Mapping[str, Any]


def toml_text(tables: Tables, comments: Mapping[str, str] | None = None) -> str:
    """Return tables as TOML."""
    # Values are texts, booleans, finite numbers, arrays of these, tables, and arrays of tables. A
    # key without a value (None) is left out. The comment of a dotted key ends its line or, for a
    # table, precedes its header; a key such as stations[1].name is of one entry of an array.
    return "\n".join(_table((), tables, comments or {})).strip("\n") + "\n"


def _table(path: tuple[str, ...], table: Tables, comments: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of a table: first its values, then its tables."""
    tables: list[tuple[str, Any]] = []
    for key, value in table.items():
        if value is None:
            continue
        if isinstance(value, Mapping) or _is_array_of_tables(value):
            tables.append((key, cast("Any", value)))
            continue
        comment = comments.get(".".join((*path, key)))
        yield f"{_key(key)} = {_value(value)}" + (f"  # {comment}" if comment else "")
    for key, value in tables:
        own = (*path, key)
        name = ".".join(_key(part) for part in own)
        several = not isinstance(value, Mapping)
        for number, entry in enumerate(cast("list[Tables]", list(value) if several else [value])):
            yield ""
            if comment := comments.get(".".join(own)):
                yield f"# {comment}"
            yield f"[[{name}]]" if several else f"[{name}]"
            numbered = {
                each.replace(f"{key}[{number}].", f"{key}.", 1): comment
                for each, comment in comments.items()
                if f"{key}[{number}]." in each
            }
            yield from _table(own, entry, {**comments, **numbered})


def _is_array_of_tables(value: object) -> bool:
    if not isinstance(value, list | tuple):
        return False
    entries = cast("list[object]", value)
    return bool(entries) and all(isinstance(entry, Mapping) for entry in entries)


def _key(key: str) -> str:
    bare = key.replace("-", "").replace("_", "")
    return key if bare.isalnum() and bare.isascii() else _text(key)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} is not a finite number")
        return repr(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(entry) for entry in cast('list[object]', value))}]"
    raise TypeError(f"a {type(value).__name__} has no form in TOML")


def _text(text: str) -> str:
    # JSON escapes all characters that TOML forbids in a basic string, except for DEL.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
