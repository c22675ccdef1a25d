"""Power logs: CSV files with a header, columns found by name.

Lines that start with ``#`` and empty lines are skipped, other columns are ignored, a byte order
mark is tolerated. Everything that cannot be used is one error with file, line and column.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from planopt.channel.measurements import Measurements
from planopt.channel.parameters import Station
from planopt.errors import InputError

DEFAULT_COLUMNS = ("x_m", "y_m", "power_dbm")
"""Names of the columns for x, y and power."""

FLAGS = {"1": True, "true": True, "0": False, "false": False}
"""What a column of flags may contain, in any case."""


def read_log(
    path: Path | str,
    columns: tuple[str, str, str] = DEFAULT_COLUMNS,
    censored_column: str | None = None,
    floor_dbm: float | None = None,
) -> Measurements:
    """Read a power log.

    Parameters
    ----------
    path
        The CSV file.
    columns
        Names of the columns for x (m), y (m) and power (dBm).
    censored_column
        Column of flags, 1 or true where the power is only known to be at most the given one.
    floor_dbm
        The receiver's floor: powers at or below it are censored, and count as at most the floor.

    Raises
    ------
    InputError
        With the file, and where they apply the line and the column: the file is missing, not text
        or empty; a column is missing; a row has too few or too many cells; a cell is empty, not a
        number or not finite; a flag is none.
    """
    file = Path(path)
    rows = _rows(file)
    first = next(rows, None)
    if first is None:
        raise InputError("the file is empty", file=file, remedy="a header and rows are needed")
    header_line, header = first
    names = [name.strip() for name in header]
    where = [_column(names, name, file, header_line) for name in columns]
    flag_at = (
        None if censored_column is None else _column(names, censored_column, file, header_line)
    )
    numbers: list[list[float]] = []
    flags: list[bool] = []
    for line, cells in rows:
        if len(cells) != len(names):
            raise InputError(
                f"{len(cells)} cells where the header has {len(names)}", file=file, row=line
            )
        numbers.append(
            [_number(cells[at], file, line, name) for at, name in zip(where, columns, strict=True)]
        )
        if flag_at is not None and censored_column is not None:
            flags.append(_flag(cells[flag_at], file, line, censored_column))
    if not numbers:
        raise InputError("the file has a header but no rows", file=file)
    table = np.array(numbers)
    power = table[:, 2].copy()
    censored = np.array(flags) if flags else np.zeros(len(power), dtype=np.bool_)
    if floor_dbm is not None:
        censored |= power <= floor_dbm
        power = np.maximum(power, floor_dbm)
    return Measurements(table[:, :2].copy(), power, censored)


def at_file_line(error: InputError, path: Path | str) -> InputError:
    """Turn an error about a measurement of a log into one about the log's line.

    Parameters
    ----------
    error
        As :func:`planopt.channel.identifiability.examine` raises it: its ``row``, if any, is the
        index of a measurement, counted from 0.
    path
        The log that the measurements were read from.
    """
    line = error.row
    if line is not None:
        # The first row is the header, so index 0 is the second one.
        line = [number for number, _ in _rows(Path(path))][line + 1]
    return InputError(error.message, file=path, key=error.key, row=line, remedy=error.remedy)


def parse_columns(text: str) -> tuple[str, str, str]:
    """Read ``x=east,y=north,power=rssi``; what is not named keeps its default.

    Raises
    ------
    InputError
        Not of that form, or something other than x, y and power is named.
    """
    remedy = "write x=NAME,y=NAME,power=NAME"
    names: dict[str, str] = dict(zip(("x", "y", "power"), DEFAULT_COLUMNS, strict=True))
    for part in text.split(","):
        what, equals, name = (piece.strip() for piece in part.partition("="))
        if what not in names or not equals or not name:
            raise InputError(f"cannot read {part!r}", key="columns", remedy=remedy)
        names[what] = name
    return names["x"], names["y"], names["power"]


def parse_station(text: str) -> Station | None:
    """Read ``X,Y`` or ``X,Y,HEIGHT`` in metres, or ``unknown`` as None.

    Raises
    ------
    InputError
        Neither of these, or a number is not finite.
    """
    if text.strip().lower() == "unknown":
        return None
    remedy = "write X,Y or X,Y,HEIGHT in metres, or unknown"
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(math.isfinite(number) for number in numbers):
        raise InputError(f"cannot read {text!r}", key="station", remedy=remedy)
    return Station((numbers[0], numbers[1]), numbers[2] if len(numbers) == 3 else 0.0)


def _rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of the header and of every row."""
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror or error}", file=file, remedy="check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise _not_text(file) from error
    if "\0" in text:
        raise _not_text(file)
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            try:
                yield number, next(csv.reader([stripped], strict=True))
            except csv.Error as error:
                raise InputError(f"not a CSV row: {error}", file=file, row=number) from error


def _not_text(file: Path) -> InputError:
    return InputError("not a text file", file=file, remedy="give a CSV file in UTF-8")


def _column(names: list[str], name: str, file: Path, line: int) -> int:
    """Where the column `name` stands."""
    if names.count(name) == 1:
        return names.index(name)
    problem = "appears twice" if name in names else "is missing"
    raise InputError(
        f"column {name!r} {problem}; the file has {', '.join(names)}",
        file=file,
        key=name,
        row=line,
        remedy="name the columns with x=NAME,y=NAME,power=NAME",
    )


def _number(text: str, file: Path, line: int, name: str) -> float:
    """A finite number."""
    cell = text.strip()
    if not cell:
        raise InputError("the cell is empty", file=file, key=name, row=line)
    try:
        # Python would read 1_0 as 10.
        number = math.nan if "_" in cell else float(cell)
    except ValueError:
        raise InputError(f"{cell!r} is not a number", file=file, key=name, row=line) from None
    if not math.isfinite(number):
        raise InputError(
            f"{cell!r} is not a finite number",
            file=file,
            key=name,
            row=line,
            remedy="remove the row, or mark it censored at the receiver's floor",
        )
    return number


def _flag(text: str, file: Path, line: int, name: str) -> bool:
    """A flag."""
    flag = FLAGS.get(text.strip().lower())
    if flag is None:
        raise InputError(
            f"{text.strip()!r} is not a flag", file=file, key=name, row=line, remedy="use 0 or 1"
        )
    return flag
