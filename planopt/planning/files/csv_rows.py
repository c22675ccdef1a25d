"""Rows and numbers of saved tables, with file, row and column where they cannot be read."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from planopt.errors import InputError
from planopt.files.regular import read_text
from planopt.planning.files.record import LARGEST, REMEDY


def read_rows(path: Path, columns: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and cells of every row below a header that must be `columns`.

    Raises
    ------
    InputError
        The file is missing or not text, has another header, or a row has too few or too many cells.
    """
    text = read_text(path)
    try:
        rows = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise InputError(f"cannot be read: {error}", file=path, remedy=REMEDY) from None
    if not rows or rows[0] != list(columns):
        raise InputError(f"the header is not {','.join(columns)}", file=path, row=1, remedy=REMEDY)
    for line, cells in enumerate(rows[1:], start=2):
        if len(cells) != len(columns):
            raise InputError(
                f"{len(cells)} cells where {len(columns)} should be",
                file=path,
                row=line,
                remedy=REMEDY,
            )
        yield line, dict(zip(columns, cells, strict=True))


def read_number(cell: str, name: str, path: Path, line: int, *, may_miss: bool) -> float:
    """A finite number, or NaN for an empty cell of a column that may have some.

    Raises
    ------
    InputError
        It is neither.
    """
    if not cell and may_miss:
        return np.nan
    try:
        number = float(cell)
    except ValueError:
        number = np.nan
    if not abs(number) <= LARGEST:
        raise InputError(
            f"{cell!r} is not a finite number", file=path, key=name, row=line, remedy=REMEDY
        )
    return number
