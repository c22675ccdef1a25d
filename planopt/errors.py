"""The errors planopt raises: what was wrong, where, and what to do about it.

Nothing else leaves the package for bad input. The command line maps :class:`InputError` and
:class:`OutputError` to exit code 2.
"""

from __future__ import annotations

from pathlib import Path


class PlanoptError(Exception):
    """Base of every error that planopt raises on purpose."""


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
        self.message = message
        self.file = None if file is None else str(file)
        self.key = key
        self.row = row
        self.remedy = remedy
        where = ", ".join(
            part
            for part in (
                self.file,
                None if row is None else f"line {row}",
                None if key is None else f"key {key}",
            )
            if part is not None
        )
        text = f"{where}: {message}" if where else message
        super().__init__(text if remedy is None else f"{text} ({remedy})")

    def located(self, file: Path | str) -> InputError:
        """The same error with its file filled in, for code that did not know it."""
        return InputError(
            self.message,
            file=self.file if self.file is not None else file,
            key=self.key,
            row=self.row,
            remedy=self.remedy,
        )


class OutputError(PlanoptError):
    """A result cannot be written where the user asked for it."""


class NoPlanError(PlanoptError):
    """There is provably no plan to look for, for instance a goal cut off by obstacles."""
