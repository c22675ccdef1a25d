"""Read input files that may be anything: devices, pipes, endless, huge or damaged files.

Every input file of planopt is read through this module, so that the file that was named is read,
no other file is, and its size is known before memory is spent on it.
"""

from __future__ import annotations

import contextlib
import os
import stat
import sys
import warnings
from collections.abc import Generator
from pathlib import Path

from planopt.errors import InputError

LARGEST_TEXT_BYTES = 64 * 2**20
"""Size limit of text files (tables, obstacles, saved JSON). A log of a million rows has 30 MB."""

LARGEST_BINARY_BYTES = 512 * 2**20
"""Size limit of binary files (npz, NetCDF, GeoTIFF)."""

LARGEST_ARRAY_VALUES = 25_000_000
"""Number of values that one array of a file may declare: a map of 5000 x 5000 cells."""

AGAIN = "copy or export the file again"
"""Remedy for damaged files."""

MEGABYTE = 2**20


def read_bytes(path: Path, largest: int = LARGEST_BINARY_BYTES) -> bytes:
    """Return the content of a regular file."""
    try:
        # Looked at before it is opened: opening a pipe waits, opening a device may do anything.
        _require_regular(path, path.stat().st_mode)
        with open(path, "rb", opener=_open_without_waiting) as stream:
            status = os.fstat(stream.fileno())
            _require_regular(path, status.st_mode)
            # Files of /proc have size 0 and any content, so the size said is not trusted.
            content = b"" if status.st_size > largest else stream.read(largest + 1)
    except FileNotFoundError as error:
        raise InputError("there is no such file", file=path, remedy="check the path") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot be read: {reason}", file=path, remedy="check the path") from error
    except ValueError as error:  # a NUL in the name
        raise InputError(f"cannot be read: {error}", file=path, remedy="check the path") from error
    size = max(status.st_size, len(content))
    if size > largest:
        raise InputError(
            f"has {size / MEGABYTE:.0f} MB, more than the limit of {largest / MEGABYTE:.0f} MB",
            file=path,
            remedy="give a smaller file, with fewer rows or larger cells",
        )
    return content


def read_text(path: Path, largest: int = LARGEST_TEXT_BYTES) -> str:
    """Return the content of a regular UTF-8 text file; a byte order mark is dropped."""
    content = read_bytes(path, largest)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not UTF-8 text: {error.reason} at byte {error.start}",
            file=path,
            remedy="save it as UTF-8 text",
        ) from None
    if "\0" in text:
        raise InputError(
            f"is not text: NUL at character {text.index(chr(0))}",
            file=path,
            remedy="give a text file",
        )
    return text


@contextlib.contextmanager
def foreign_reader(path: Path, kind: str) -> Generator[None]:
    """Turn whatever a dependency makes of a damaged file into one error of ours.

    Readers of binary formats check little: a damaged file ends in whatever its bytes lead to,
    among them warnings, MemoryError, errors of other readers, and errors within their callbacks,
    which Python would print. Their words tell of their insides, not of the file, and are left out.
    """
    hooks = sys.excepthook, sys.unraisablehook
    sys.excepthook, sys.unraisablehook = _unseen, _unseen
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError as error:
        raise (error if error.file is not None else error.located(path)) from error.__cause__
    except Exception as error:
        raise InputError(
            f"is damaged, or not {kind} that can be read", file=path, remedy=AGAIN
        ) from error
    finally:
        sys.excepthook, sys.unraisablehook = hooks


def _unseen(*_: object) -> None:
    """Print nothing."""


def require_array_size(path: Path, key: str, *lengths: int) -> None:
    """Refuse an array that declares too many values, before it is read."""
    count = 1
    for length in lengths:
        count *= int(length)
    if min(lengths, default=0) < 0 or count > LARGEST_ARRAY_VALUES:
        shape = " x ".join(str(int(length)) for length in lengths)
        raise InputError(
            f"declares {shape} values, more than the limit of {LARGEST_ARRAY_VALUES}",
            file=path,
            key=key,
            remedy="give a smaller map",
        )


def _open_without_waiting(name: str, flags: int) -> int:
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))


def _require_regular(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise InputError(
            "is a folder, not a file" if stat.S_ISDIR(mode) else "is not a regular file",
            file=path,
            remedy="name a file",
        )
