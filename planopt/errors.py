"""Errors raised by planopt: the fault, its location and a remedy."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

A_FOLDER = 'give the name of a folder, such as "run"'  # Remedy for a missing folder name
LONGEST_WORD = 300  # Maximum length of a word in a message; file paths are rarely longer
LONGEST_MESSAGE = 1200  # Maximum length of a message; longer ones are shortened in the middle
LISTED = 12  # Maximum number of names listed in a message


class PlanoptError(Exception):
    """Base class of all errors that planopt raises on purpose.

    Parameters
    ----------
    text
        The message. It may quote names and values from any file, so it is shortened and made
        printable, without terminal codes and lone surrogates.
    """

    def __init__(self, text: str = "") -> None:
        super().__init__(printable(text))


def printable(text: str) -> str:
    r"""Return `text` on one line, with unprintable characters escaped and long words shortened."""
    words = (_cut(word, LONGEST_WORD) for word in text.split())
    return escaped(_cut(" ".join(words), LONGEST_MESSAGE))


def escaped(line: str) -> str:
    """Return `line` with unprintable characters escaped."""
    if line.isprintable():
        return line
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in line
    )


def require_text(text: str, what: str) -> None:
    """Raise an InputError if UTF-8 cannot encode `text`, e.g. a file name with invalid bytes."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{what} {text!a} is not UTF-8", remedy="use a name in valid UTF-8"
        ) from None


def path_of(key: str, value: Any, remedy: str) -> Path:
    """Return the user's file path; raise an InputError if it is invalid."""
    try:
        return Path(value)
    except TypeError:
        raise InputError(f"is of type {type(value).__name__}", key=key, remedy=remedy) from None


def listed(names: Iterable[str]) -> str:
    """Return text for a message: the first names and the number of further names."""
    known = list(names)
    shown = ", ".join(_cut(name, LONGEST_WORD // 5) for name in known[:LISTED])
    more = len(known) - LISTED
    return f"{shown} and {more} more" if more > 0 else shown or "none"


def _cut(text: str, most: int) -> str:
    """Return `text`, shortened in the middle if it has more than `most` characters."""
    if len(text) <= most:
        return text
    kept = most // 2
    return f"{text[:kept]}...{text[-kept // 2 :]}"


_PREDICATE = re.compile(
    "(is|are|has|have|was|does|do|must|should|cannot be|needs?|contains?|requires?|declares?|adds?"
    "|begins?|ends?|returned|reads|lacks|leaves?|covers?|divides?|crosses|visits|makes?|sets|lets"
    "|keeps?|differ|applies|refers|belongs) "
)
"""Pattern of messages that begin with a verb, which need the key or file as subject."""


def _sentence(where: list[str], message: str) -> str:
    """Return location and message as one sentence, of which the location may be the subject."""
    if where and _PREDICATE.match(message):
        *before, subject = where[::-1] if message == "does not exist" else where
        words = f"{subject} {message}"
        return f"{', '.join(before)}: {words}" if before else words
    return f"{', '.join(where)}: {message}" if where else message


class InputError(PlanoptError):
    """Error in user input.

    Parameters
    ----------
    message
        The fault, with the offending value. A message that begins with a verb ("is 0, should be
        at least 1") is completed by the key, or without a key by the file.
    file
        File that contains the fault.
    key
        The key (problem files, ``robots[0].start_m``) or column (logs).
    row
        Line number in the file, counted from 1.
    remedy
        Advice on how to correct the input.
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
        where = [self.file, row and f"line {row}", self.key]
        text = _sentence([str(part) for part in where if part is not None], self.message)
        super().__init__(text if remedy is None else f"{text} ({self.remedy})")

    def located(self, file: Path | str | None, remedy: str | None = None) -> InputError:
        """Return the error with file and remedy filled in if they are missing."""
        return InputError(
            self.message,
            file=file if self.file is None else self.file,
            key=self.key,
            row=self.row,
            remedy=remedy if self.remedy is None else self.remedy,
        )

    def under(self, key: str) -> InputError:
        """Return the error with `key`, a table or entry, in front of the key in the error."""
        below = f"{key}.{self.key}" if self.key else key
        return InputError(self.message, file=self.file, key=below, row=self.row, remedy=self.remedy)

    def remedied(self, remedy: str) -> InputError:
        """Return the error, with `remedy` added if it has none."""
        return self.located(None, remedy)


class OutputError(PlanoptError):
    """Error raised if a result cannot be written."""


class NoPlanError(PlanoptError):
    """Error raised if it is proven that no plan exists, for instance behind closed obstacles."""
