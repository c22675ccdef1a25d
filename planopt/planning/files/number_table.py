"""Tables of numbers as CSV, to the last digit; a cell is empty where there is no number."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.planning.files.csv_rows import read_number, read_rows
from planopt.planning.files.solution_json import finite_list

NumberTable = Mapping[str, NDArray[np.float64]]
"""Columns of equal length by name, NaN where there is no number."""


def table_text(table: NumberTable) -> str:
    """The file of a table."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    for row in zip(*(finite_list(column) for column in table.values()), strict=True):
        writer.writerow(["" if cell is None else cell for cell in row])
    return text.getvalue()


def read_table(path: Path, columns: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Read what :func:`table_text` wrote.

    Raises
    ------
    InputError
        It is missing, not text, has other columns or a cell that is no number.
    """
    found: dict[str, list[float]] = {name: [] for name in columns}
    for line, row in read_rows(path, columns):
        for name in columns:
            found[name].append(read_number(row[name], name, path, line, may_miss=True))
    return {name: np.array(column, dtype=np.float64) for name, column in found.items()}
