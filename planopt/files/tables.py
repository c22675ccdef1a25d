"""Tables of results: columns declared once, for CSV files, DataFrames, documentation and checks.

Numbers are written with full precision; an empty cell means no value.
"""

import csv
import io
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.reading import read_text

LARGEST = 1e9
"""Maximum magnitude of positions, times, powers and parameters in a saved file."""

REMEDY = "save the result again"

LARGEST_BYTES = 512 * 2**20
"""Size limit of a table in bytes."""
Data = Mapping[str, NDArray[Any]]
"""Columns of equal length by name; NaN and empty text represent missing values."""


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    name: str
    meaning: str
    unit: str = ""
    kind: Literal["number", "count", "text", "flag"] = "number"  # Flags are saved as 1 or 0
    required: bool = False  # Whether every cell must have a value
    largest: float = LARGEST  # Maximum magnitude of a number
    # Function from a log to the values; by default its attribute of the same name
    source: Callable[[Any], NDArray[Any]] | None = None


_DTYPES: dict[str, Any] = {
    "number": np.float64,
    "count": np.int64,
    "text": np.str_,
    "flag": np.str_,
}


def names_of(columns: Iterable[Column]) -> tuple[str, ...]:
    """Return the names of columns, the header of a table."""
    return tuple(column.name for column in columns)


def table_of(columns: Iterable[Column], log: object, **values: NDArray[Any]) -> Data:
    """Return a log as a table; columns in `values` override the log's columns."""
    return {
        column.name: values[column.name]
        if column.name in values
        else getattr(log, column.name)
        if column.source is None
        else column.source(log)
        for column in columns
    }


def table_text(columns: Sequence[Column], data: Data) -> str:
    """Return a table as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names_of(columns))
    writer.writerows(zip(*(_cells(data[column.name]) for column in columns), strict=True))
    return text.getvalue()


def _cells(values: NDArray[Any]) -> list[Any]:
    if values.dtype.kind != "f":
        return values.tolist()
    return ["" if not np.isfinite(value) else value for value in values.tolist()]


def read_table(path: Path, columns: Sequence[Column]) -> dict[str, NDArray[Any]]:
    """Read a table that has exactly these columns."""
    cells: dict[str, list[Any]] = {column.name: [] for column in columns}
    for line, row in read_rows(path, names_of(columns)):
        for column, cell in zip(columns, row, strict=True):
            try:
                cells[column.name].append(_value(column, cell))
            except ValueError as error:
                raise InputError(
                    str(error), file=path, key=column.name, row=line, remedy=REMEDY
                ) from None
    return {
        column.name: np.array(cells[column.name], dtype=_DTYPES[column.kind]) for column in columns
    }


def read_rows(path: Path, header: Sequence[str]) -> Iterable[tuple[int, list[str]]]:
    """Yield line number and cells of every row below the header."""
    text = read_text(path, LARGEST_BYTES)
    try:
        rows = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise InputError(f"cannot be read: {error}", file=path, remedy=REMEDY) from None
    if not rows or rows[0] != list(header):
        raise InputError(
            f"the header should be {','.join(header)}", file=path, row=1, remedy=REMEDY
        )
    for line, cells in enumerate(rows[1:], start=2):
        if len(cells) != len(header):
            message = f"the row has {len(cells)} cells, but the header has {len(header)}"
            raise InputError(message, file=path, row=line, remedy=REMEDY)
        yield line, cells


def _value(column: Column, cell: str) -> float | int | str:
    """Return the value of a cell; raise a ValueError that describes the cell's fault."""
    if column.kind == "text":
        return cell
    if not cell and not column.required:
        return np.nan if column.kind == "number" else ""
    if column.kind == "flag":
        if cell not in ("0", "1"):
            raise ValueError(f"{cell!r} is neither 0 nor 1")
        return cell
    try:
        number = float(cell)
    except ValueError:
        number = np.nan
    if not (math.isfinite(number) and abs(number) <= column.largest):
        raise ValueError(f"{cell!r} is not a finite number")
    if column.kind == "count":
        if number != int(number):
            raise ValueError(f"{cell!r} is not a whole number")
        return int(number)
    return number


def comparable(data: Data) -> dict[str, list[Any]]:
    """Return the columns of a table as lists, for comparisons."""
    return {name: values.tolist() for name, values in data.items()}


def require_pandas() -> Any:
    """Return the module pandas, or raise an InputError with an installation hint."""
    try:
        return import_module("pandas")
    except ImportError:
        raise InputError("pandas is not installed", remedy="pip install pandas") from None


def dataframe(columns: Sequence[Column], data: Data) -> Any:
    """Return a table as a pandas DataFrame; flags are nullable booleans."""
    pandas = require_pandas()
    frame: dict[str, Any] = {}
    for column in columns:
        values = data[column.name]
        if column.kind == "flag":
            flags = [{"1": True, "0": False}.get(cell) for cell in values.tolist()]
            frame[column.name] = pandas.array(flags, dtype="boolean")
        else:
            frame[column.name] = values.tolist() if column.kind == "text" else values
    return pandas.DataFrame(frame)


def documented(columns: Iterable[Column]) -> str:
    """Return the columns as a Markdown table."""
    rows = [f"| `{column.name}` | {column.unit} | {column.meaning} |" for column in columns]
    return "\n".join(["| column | unit | meaning |", "|---|---|---|", *rows])
