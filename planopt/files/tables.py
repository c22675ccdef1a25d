"""Tables and typed JSON of results: columns declared once, for files, DataFrames and checks.

Numbers are written with full precision; an empty cell means no value. JSON has neither NaN nor
infinity: both are written as null, which is read as NaN.
"""

import contextlib
import csv
import io
import math
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.reading import read_text

LARGEST = 1e9  # Maximum magnitude of positions, times, powers and parameters in a saved file

REMEDY = "save the result again"

LARGEST_BYTES = 512 * 2**20  # Size limit of a table in bytes
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


Value = TypeVar("Value")

NOT_FINITE = ("nan", "inf", "-inf")  # Non-finite numbers as written by earlier versions


def encoded(value: object) -> Any:
    """Return a value as JSON data; dataclasses become tables of their fields."""
    match value:
        case Enum():
            return value.value
        case None | bool() | int() | str():
            return value
        case float():
            return finite(value)
        case np.ndarray() | np.generic():
            return encoded(cast("NDArray[Any]", value).tolist())
        case list() | tuple():
            return [encoded(part) for part in cast("Sequence[object]", value)]
        case Mapping():
            table = cast("Mapping[str, object]", value)
            return {name: encoded(part) for name, part in table.items()}
        case _ if is_dataclass(value) and not isinstance(value, type):
            return {part.name: encoded(getattr(value, part.name)) for part in fields(value)}
        case _:
            raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def finite(value: float | None) -> float | None:
    """Return a number, or None if it is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def decoded(kind: type[Value], data: object) -> Value:
    """Return the value of type `kind` from JSON data; inverse of :func:`encoded`."""
    return cast("Value", _decoded(kind, data))


def _decoded(kind: Any, data: Any) -> Any:
    origin = get_origin(kind)
    if kind is Any:
        return data
    if kind is None or kind is type(None):
        return _of_type(data, type(None))
    if origin in (Union, types.UnionType):
        kinds = get_args(kind)
        if data is None and type(None) in kinds:
            return None
        for each in kinds:
            with contextlib.suppress(ValueError):
                return _decoded(each, data)
        raise ValueError(f"{type(data).__name__} is none of {kinds}")
    if origin is np.ndarray:
        dtype = np.dtype(get_args(get_args(kind)[1])[0])
        return np.array(_numbers(dtype, data), dtype=dtype)
    if origin is tuple:
        parts = _of_type(data, list)
        inner = get_args(kind)
        if inner[1:] == (...,):
            return tuple(_decoded(inner[0], part) for part in parts)
        if len(inner) != len(parts):
            raise ValueError(f"{len(parts)} entries where {len(inner)} should be")
        return tuple(_decoded(one, part) for one, part in zip(inner, parts, strict=True))
    if origin is list:
        return [_decoded(get_args(kind)[0], part) for part in _of_type(data, list)]
    if origin is not None and issubclass(origin, Mapping):
        table = _of_type(data, dict)
        return {str(name): _decoded(get_args(kind)[1], part) for name, part in table.items()}
    if is_dataclass(kind):
        table, hints = _of_type(data, dict), get_type_hints(kind)
        names = [part.name for part in fields(kind) if part.init]
        if set(names) != set(table):
            wrong = ", ".join(sorted(set(names) ^ set(table))[:5])
            raise ValueError(f"an entry has missing or unknown keys: {wrong}")
        made = cast("type[Any]", kind)
        return made(**{name: _decoded(hints[name], table[name]) for name in names})
    if issubclass(kind, Enum):
        return kind(data)
    if kind is float:
        return _float(data)
    return _of_type(data, kind)


def _numbers(dtype: np.dtype[Any], data: Any) -> Any:
    """Return nested lists of JSON data with all values checked against an array's `dtype`."""
    if isinstance(data, list):
        return [_numbers(dtype, part) for part in cast("list[Any]", data)]
    if dtype.kind == "f":
        return _float(data)
    return _of_type(data, bool if dtype.kind == "b" else int)


def _float(data: Any) -> float:
    if data is None:
        return math.nan
    if isinstance(data, str) and data in NOT_FINITE:
        return float(data)
    if isinstance(data, bool) or not isinstance(data, int | float):
        raise ValueError(f"{data!r} is no number")
    return float(data)


def _of_type(data: Any, kind: type[Any]) -> Any:
    # In Python bool is a subclass of int; here it is not accepted as one.
    if type(data) is not kind:
        raise ValueError(f"{type(data).__name__} where {kind.__name__} should be")
    return data


def seed_in(file: Path, data: Mapping[str, object]) -> int:
    """Return the random seed in a saved JSON object, which must be an integer."""
    value = data.get("seed")
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(
            "is missing, or is not a whole number",
            file=file,
            key="seed",
            remedy="save the result again",
        )
    return value
