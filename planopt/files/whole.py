"""Write files whole or not at all, and JSON strictly."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import secrets
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from planopt.errors import OutputError

STAGING = ".planopt-new-"
"""Prefix of hidden files and folders that are being written."""


def hidden_name(suffix: str = "") -> str:
    """Return a new hidden name that identifies the process that writes."""
    return f"{STAGING}{platform.node()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary neighbour of `path`, then move it into place."""
    # The name is known before the file exists, so that an interrupt cannot leave the file.
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
    """Write `text` to `path` as UTF-8, whole or not at all."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def strict_text(data: Mapping[str, Any]) -> str:
    """Return `data` as one line of strict JSON."""
    return json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n"


def remove_remains(folder: Path) -> None:
    """Remove hidden files and folders of processes of this machine that were killed."""
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
        # On Windows the signal 0 would end the process.
        return os.name != "posix" or os.kill(pid, 0) is None
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True


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
