"""CSV tables of saved results: written in one form, read back with every cell checked."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.regular import read_text

LARGEST_BYTES = 512 * 2**20
"""Size limit of a table."""


def csv_text(columns: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    """Return a table as text."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


def read_rows(path: Path, columns: tuple[str, ...]) -> list[dict[str, str]]:
    """Return the rows of a CSV file with exactly these columns."""
    rows = list(csv.reader(io.StringIO(read_text(path, LARGEST_BYTES))))
    if not rows or tuple(rows[0]) != columns:
        raise InputError(
            f"has not the columns {', '.join(columns)}", file=path, row=1, remedy="save it again"
        )
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(columns):
            raise InputError(
                f"has {len(row)} of {len(columns)} columns",
                file=path,
                row=number,
                remedy="save the result again",
            )
    return [dict(zip(columns, row, strict=True)) for row in rows[1:]]


def finite_numbers(
    path: Path,
    rows: list[dict[str, str]],
    columns: tuple[str, ...],
    empty: float | None = None,
) -> NDArray[np.float64]:
    """Return some columns as numbers, ``(rows, columns)``."""
    found = np.zeros((len(rows), len(columns)))
    for number, row in enumerate(rows):
        for place, column in enumerate(columns):
            text = row[column]
            if text == "" and empty is not None:
                found[number, place] = empty
                continue
            try:
                found[number, place] = float(text)
            except ValueError:
                found[number, place] = math.nan
            if not math.isfinite(found[number, place]):
                raise InputError(
                    f"{text!r} is no finite number",
                    file=path,
                    key=column,
                    row=number + 2,
                    remedy="save the result again",
                )
    return found


def whole_number(file: Path, data: Mapping[str, object], key: str) -> int:
    """Return a whole number of a saved JSON object."""
    value = cast("object", data.get(key))
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(
            "is missing or no whole number", file=file, key=key, remedy="save the result again"
        )
    return value
