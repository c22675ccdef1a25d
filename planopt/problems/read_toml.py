"""Read the tables of a TOML file, or say in which line it is wrong."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from planopt.errors import InputError


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of the TOML file `path`.

    Raises
    ------
    InputError
        It cannot be read, is not UTF-8, or does not parse; with the line where that is known.
    """
    try:
        # Some editors put a byte order mark first, which TOML does not know.
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not UTF-8: {error.reason} at byte {error.start}",
            file=path,
            remedy="save it as UTF-8 text",
        ) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"cannot be read: {reason}", file=path) from None
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError("is not TOML: nested too deeply", file=path) from None
    except ValueError as error:  # TOMLDecodeError, and integers too long for Python
        raise _parse_error(str(error), text, path) from None


def _parse_error(message: str, text: str, path: Path) -> InputError:
    """The parser's message with its line number as the row."""
    found = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", message)
    row, remedy = None, None
    if found is not None:
        message = message[: found.start()]
        row = int(found[1]) if found[1] else len(text.splitlines())
        remedy = f"at column {found[2]}" if found[2] else "at the end of the file"
    return InputError(f"is not TOML: {message}", file=path, row=row, remedy=remedy)
