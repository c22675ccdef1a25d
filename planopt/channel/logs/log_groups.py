"""Rows of a power log that belong together: one day, or one block of time within a day.

What is written is ``day`` for whole days, ``day,t_s:600`` for blocks of 600 in the column ``t_s``
within each day: rows are together where all the columns agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.channel.logs.log_file import DEFAULT_FORMAT, read_columns, read_label, read_number
from planopt.channel.logs.log_format import LogFormat
from planopt.errors import InputError


@dataclass(frozen=True)
class GroupColumn:
    """A column that tells groups apart."""

    name: str  # Of the column
    # Numbers within one block of this length, counted from zero, are together; None where each text
    # is a group
    block: float | None = None


def parse_groups(text: str) -> tuple[GroupColumn, ...]:
    """Read ``COLUMN[:BLOCK][,...]``.

    Raises
    ------
    InputError
        Not of that form, or a block is not positive.
    """
    return tuple(_column(part) for part in text.split(","))


def read_groups(
    path: Path | str, columns: Sequence[GroupColumn], log_format: LogFormat = DEFAULT_FORMAT
) -> NDArray[np.intp]:
    """Label of the group of each row of a log, in the order of first appearance; ``(n,)``.

    Parameters
    ----------
    path
        The CSV file, as :func:`planopt.channel.logs.log_file.read_log` reads it.
    columns
        What tells groups apart; at least one.
    log_format
        Says which rows count.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, a cell is empty, or one that should be in a
        block is not a number.
    """
    labels: dict[tuple[str | int, ...], int] = {}
    found: list[int] = []
    for line, cells in read_columns(path, [column.name for column in columns], log_format):
        key = tuple(
            _label(cell, column, Path(path), line)
            for cell, column in zip(cells, columns, strict=True)
        )
        found.append(labels.setdefault(key, len(labels)))
    return np.array(found, dtype=np.intp)


def _column(text: str) -> GroupColumn:
    """Read ``COLUMN`` or ``COLUMN:BLOCK``."""
    name, colon, length = (part.strip() for part in text.partition(":"))
    if name and not colon:
        return GroupColumn(name)
    try:
        block = float(length)
    except ValueError:
        block = math.nan
    if not name or not 0.0 < block < math.inf:
        raise InputError(
            f"cannot read {text!r}",
            key="--hold-out",
            remedy="write COLUMN or COLUMN:BLOCK with a block above 0, and commas between",
        )
    return GroupColumn(name, block)


def _label(cell: str, column: GroupColumn, file: Path, line: int) -> str | int:
    """Return the label of the group in a cell."""
    if column.block is None:
        return read_label(cell, file, line, column.name)
    return math.floor(read_number(cell, file, line, column.name) / column.block)
