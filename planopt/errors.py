"""The errors planopt raises: what was wrong, where, and what to do about it.

Nothing else leaves the package for bad input. The command line maps :class:`InputError` and
:class:`OutputError` to exit code 2.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

A_FOLDER = 'give the name of a folder, such as "run"'
"""Remedy where the name of a folder is missing."""

LONGEST_WORD = 300
"""Longer words in messages are cut; paths of files are rarely longer."""

LONGEST_MESSAGE = 1200
"""Longer messages are cut in the middle."""

LISTED = 12
"""Number of names that a message lists."""


class PlanoptError(Exception):
    """Base of every error that planopt raises on purpose.

    Parameters
    ----------
    text
        The message. Names and values in it may come from any file: it is shortened and made
        printable, without terminal codes and lone surrogates.
    """

    def __init__(self, text: str = "") -> None:
        super().__init__(printable(text))


def printable(text: str) -> str:
    r"""Return `text` on one line, escaped where it cannot be printed, its long words cut."""
    words = (_cut(word, LONGEST_WORD) for word in text.split())
    return escaped(_cut(" ".join(words), LONGEST_MESSAGE))


def escaped(line: str) -> str:
    """Return `line` with an escape for every character that cannot be printed."""
    if line.isprintable():
        return line
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in line
    )


def require_text(text: str, what: str) -> None:
    """Refuse text that no UTF-8 file can hold, such as a file name that is not UTF-8."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{what} {text!a} is not UTF-8", remedy="rename it to what UTF-8 can hold"
        ) from None


def path_of(key: str, value: Any, remedy: str) -> Path:
    """Return a path that a user gives."""
    try:
        return Path(value)
    except TypeError:
        raise InputError(f"is a {type(value).__name__}", key=key, remedy=remedy) from None


def listed(names: Iterable[str]) -> str:
    """Return names for a message: the first ones, and the number of others."""
    known = list(names)
    shown = ", ".join(_cut(name, LONGEST_WORD // 5) for name in known[:LISTED])
    more = len(known) - LISTED
    return f"{shown} and {more} more" if more > 0 else shown or "none"


def _cut(text: str, most: int) -> str:
    """Return `text` without its middle where it is longer than `most`."""
    if len(text) <= most:
        return text
    kept = most // 2
    return f"{text[:kept]}...{text[-kept // 2 :]}"


class InputError(PlanoptError):
    """Something the user gave cannot be used.

    Parameters
    ----------
    message
        What was wrong, with the offending value.
    file
        The file it stands in.
    key
        The key (problem files, ``robots[0].start_m``) or column (logs).
    row
        The line number in the file, the first line being 1.
    remedy
        What to do about it.
    """

    def __init__(
        self,
        message: str,
        *,
        file: Path | str | None = None,
        key: str | None = None,
        row: int | None = None,
        remedy: str | None = None,
    ) -> None:
        self.message = printable(message)
        self.file = None if file is None else printable(str(file))
        self.key = None if key is None else printable(key)
        self.row = row
        self.remedy = None if remedy is None else printable(remedy)
        line, place = row and f"line {row}", None if key is None else f"key {key}"
        where = ", ".join(str(part) for part in (self.file, line, place) if part is not None)
        text = f"{where}: {self.message}" if where else self.message
        super().__init__(text if remedy is None else f"{text} ({self.remedy})")

    def located(self, file: Path | str | None, remedy: str | None = None) -> InputError:
        """Return the error with file and remedy filled in where they are unknown."""
        return InputError(
            self.message,
            file=file if self.file is None else self.file,
            key=self.key,
            row=self.row,
            remedy=remedy if self.remedy is None else self.remedy,
        )

    def remedied(self, remedy: str) -> InputError:
        """Return the error with a remedy if it has none."""
        return self.located(None, remedy)


class OutputError(PlanoptError):
    """A result cannot be written."""


class NoPlanError(PlanoptError):
    """There is provably no plan to look for, for instance a goal cut off by obstacles."""
