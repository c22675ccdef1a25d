"""Write files whole or not at all, and JSON strictly."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from planopt.errors import OutputError

_WRITER = "-by-"
"""Stands before the number of the process that writes, in the name of a temporary file."""


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a temporary neighbour of `path`, then move it into place."""
    # The name is known before the file is there, so that no interrupt comes between the two.
    own = f".{path.stem}{_WRITER}{os.getpid()}-{secrets.token_hex(4)}{path.suffix}"
    temporary = path.parent / own
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch(exist_ok=False)
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_remains(folder: Path) -> None:
    """Remove the temporary files of processes of this machine that were killed while writing."""
    for path in folder.glob(f".*{_WRITER}*"):
        writer = path.name.rpartition(_WRITER)[2].partition("-")[0]
        if os.name == "posix" and writer.isdigit() and not _is_running(int(writer)):
            path.unlink(missing_ok=True)


def _is_running(pid: int) -> bool:
    """Return whether there is a process of this number."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` as UTF-8, whole or not at all."""

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_whole(path, write)


def strict_text(data: Mapping[str, Any]) -> str:
    """Return `data` as one line of strict JSON."""
    return json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n"


def writable_folder(path: Path) -> Path:
    """Make `path` a folder that can be written into, before any work is spent on results."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path):
            pass
    except OSError as error:
        raise OutputError(
            f"{path}: not a folder that can be written: {error.strerror or error} "
            "(choose another --out)"
        ) from error
    return path
