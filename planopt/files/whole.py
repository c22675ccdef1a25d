"""Write files whole or not at all, and JSON strictly."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from planopt.errors import OutputError


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a temporary neighbour of `path`, then move it into place.

    Parameters
    ----------
    path
        Where the file is to be.
    write
        Called with the temporary path; it has the same ending as `path`, because writers such as
        ``numpy.savez`` and ``matplotlib`` choose the format by it.

    Raises
    ------
    OutputError
        The folder cannot be made or the file cannot be written. Nothing is left behind.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        temporary = Path(name)
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` as UTF-8, whole or not at all."""

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_whole(path, write)


def strict_text(data: Mapping[str, Any]) -> str:
    """Return `data` as one line of strict JSON.

    Raises
    ------
    ValueError
        A number in it is not finite.
    """
    return json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n"


def writable_folder(path: Path) -> Path:
    """Make `path` a folder that can be written into, before any work is spent on results.

    Raises
    ------
    OutputError
        It is a file, or it cannot be made or written into.
    """
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
