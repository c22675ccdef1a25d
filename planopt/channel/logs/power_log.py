"""Reading of power logs and their times as measurements; errors name the line and the column."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.logs.log_format import DEFAULT_FORMAT, GroupColumn, LogFormat
from planopt.channel.logs.log_table import Cell, LogTable
from planopt.channel.logs.readers import LogColumns, columns_of, read_table, readings_of
from planopt.channel.measurements import LARGEST_POWER_DBM, LEAST_POWER_DBM, Frame, Measurements
from planopt.errors import InputError, listed
from planopt.keys import LARGEST_COORDINATE_M
from planopt.world.geodesy import (
    FARTHEST_M,
    LARGEST_LATITUDE_DEG,
    LARGEST_LONGITUDE_DEG,
    east_north_m,
)

UNIX_SCALES = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3), (1e8, 1.0))
"""Smallest Unix times in ns, us, ms and s (from 1973 on), each with its unit in seconds."""
DATES = ("%d.%m.%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%H:%M:%S", "%H:%M:%S.%f")
"""Accepted date formats in addition to ISO 8601."""


def times_s(cells: Iterable[Cell]) -> Floats:
    """Return the times in seconds; Unix times and dates are relative to the earliest one."""
    cells = list(cells)
    first = cells[0].label()
    if _date(first) is not None and not _is_number(first):
        return _from_earliest(np.array([_date_s(cell) for cell in cells]))
    numbers = np.array([cell.number() for cell in cells])
    for least, unit_s in UNIX_SCALES:
        if np.abs(numbers).min() >= least:
            return _from_earliest(numbers) * unit_s
    return numbers


def _from_earliest(values: Floats) -> Floats:
    return values - values.min()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _date(text: str) -> datetime | None:
    """Return a date or a time of day; None if the text is neither."""
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        pass
    for form in DATES:
        try:
            return datetime.strptime(text, form)
        except ValueError:
            continue
    return None


def _date_s(cell: Cell) -> float:
    found = _date(cell.label())
    if found is None:
        raise cell.error(
            f"{cell.text.strip()!r} is not a date", "write dates as 2026-03-14T09:26:53"
        )
    since = datetime(1970, 1, 1, tzinfo=found.tzinfo)
    return (found - since).total_seconds()


RANGES_M = ((-LARGEST_COORDINATE_M, LARGEST_COORDINATE_M, "m"),) * 2
"""Range and unit of x and of y in metres."""
RANGES_DEG = (
    (-LARGEST_LONGITUDE_DEG, LARGEST_LONGITUDE_DEG, "degrees"),
    (-LARGEST_LATITUDE_DEG, LARGEST_LATITUDE_DEG, "degrees"),
)
"""Range and unit of longitude and of latitude."""

POWER_RANGE = (LEAST_POWER_DBM, LARGEST_POWER_DBM, "dBm")

ACCURACY_RADIUS = math.sqrt(-2.0 * math.log(1.0 - 0.68))
"""Radius of probability 68 %, as Android reports it, in standard deviations of a coordinate."""


@dataclass(frozen=True)
class PowerLog:
    """Measurements of a log, in the order of its rows."""

    measurements: Measurements
    # Labels by receiver number, the reference first; empty without a receiver column
    receivers: tuple[str, ...]
    columns: LogColumns
    power_unit: str  # dBm, mW or `DETECTED_MW`
    transmitters: Mapping[str, int]  # Numbers of readings; empty without a transmitter column


DETECTED_MW = "mW, as their values show"
"""Unit of powers that are not declared as milliwatts, but lie between 0 and 1."""
Source = Path | str | Frame
"""A log file, or a data frame."""


def read_log(source: Source, log_format: LogFormat = DEFAULT_FORMAT) -> Measurements:
    """Read the measurements of a power log.

    Parameters
    ----------
    source
        File: text with a header, SQLite (``.db``, ``.sqlite``) or Parquet; or a DataFrame of
        pandas or polars, or a GeoDataFrame of points.
    log_format
        Columns, units, origin and row filter.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, a cell has no number, or a value is out of
        range; the error names line and column.

    Examples
    --------
    >>> import planopt
    >>> table = {"x_m": [0.0, 5.0], "y_m": [1.0, 2.0], "rssi": [-60, -64]}
    >>> import pandas
    >>> len(planopt.channel.read_log(pandas.DataFrame(table)))
    2
    """
    return read_power_log(source, log_format).measurements


def read_power_log(source: Source, log_format: LogFormat = DEFAULT_FORMAT) -> PowerLog:
    """Read the measurements and the receiver labels of a power log."""
    table, columns = _selected(source, log_format)
    return measurements_of(table, columns, log_format)


def measurements_of(table: LogTable, columns: LogColumns, log_format: LogFormat) -> PowerLog:
    """Return the measurements in a table of readings."""
    named = (columns.x, columns.y, columns.power)
    cells = [table.numbers(name) for name in named]
    x, y, power = (np.array([cell.number() for cell in column]) for column in cells)
    unit = log_format.power_unit or _power_unit(columns.power, power)
    if unit != "dBm":
        if (power <= 0.0).any():
            raise cells[2][int(np.argmax(power <= 0.0))].error(
                "the power in mW should be above 0", "remove the row, or give --power-unit dBm"
            )
        power = 10.0 * np.log10(power)
    censored = np.zeros(len(power), dtype=np.bool_)
    if log_format.censored_column is not None:
        censored |= np.array([cell.flag() for cell in table.cells(log_format.censored_column)])
    if log_format.floor_dbm is not None:
        censored |= power <= log_format.floor_dbm
        power = np.maximum(power, log_format.floor_dbm)
    ranges = (*(RANGES_DEG if columns.in_degrees else RANGES_M), POWER_RANGE)
    for name, values, (least, largest, words) in zip(named, (x, y, power), ranges, strict=True):
        outside = np.flatnonzero((values < least) | (values > largest)).tolist()
        if outside:
            raise InputError(
                f"is {values[outside[0]]:g} {words}, which is out of range",
                file=table.file,
                key=name,
                row=table.rows[outside[0]][0],
                remedy=f"the range is {least:g} to {largest:g} {words}; correct or remove the row",
            )
    receiver = log_format.receiver_column
    labels = [cell.label() for cell in table.cells(receiver)] if receiver is not None else []
    # Receivers are numbered by first appearance.
    number_of = {label: number for number, label in enumerate(dict.fromkeys(labels))}
    measurements = Measurements(
        _positions_m(table, x, y, log_format),
        power,
        censored,
        resolution_db=np.full(len(power), log_format.resolution_db),
        position_std_m=_position_std_m(table, columns, log_format),
        time_s=np.zeros(len(power)) if columns.time is None else times_s(table.cells(columns.time)),
        receiver=np.array([number_of[each] for each in labels], dtype=np.intp),
    )
    column = columns.transmitter
    heard = {} if column is None or column not in table.names else labels_of(table, column)
    return PowerLog(measurements, tuple(number_of), columns, unit, heard)


def _power_unit(name: str, power: Floats) -> str:
    """Return the unit of powers, inferred from the column name or else from the values."""
    if name.lower().endswith("mw"):
        return "mW"
    # A receiver measures less than 0 dBm, which is 1 mW.
    between = len(power) and 0.0 <= power.min() and 0.0 < power.max() <= 1.0
    return DETECTED_MW if between else "dBm"


def _position_std_m(table: LogTable, columns: LogColumns, log_format: LogFormat) -> Floats:
    """Return each position's standard deviation (n,), from its accuracy cell, else the format."""
    if columns.accuracy is None:
        return np.full(len(table.rows), log_format.position_std_m)
    cells = table.numbers(columns.accuracy)
    found = np.array(
        [
            cell.number() / ACCURACY_RADIUS if cell.text.strip() else log_format.position_std_m
            for cell in cells
        ]
    )
    if (found < 0.0).any():
        raise cells[int(np.argmax(found < 0.0))].error(
            "the accuracy is negative", "write an accuracy in metres of at least 0"
        )
    return found


def _positions_m(table: LogTable, x: Floats, y: Floats, log_format: LogFormat) -> Floats:
    if log_format.origin_deg is None:
        return np.column_stack([x, y])
    positions_m = east_north_m(x, y, log_format.origin_deg)
    afar = np.flatnonzero(np.isnan(positions_m[:, 0])).tolist()
    if afar:
        raise InputError(
            f"the position is more than {FARTHEST_M / 1000.0:.0f} km from the origin",
            file=table.file,
            row=table.rows[afar[0]][0],
            remedy="give an origin near the measurements; x is the longitude, y the latitude",
        )
    return positions_m


def at_file_line(
    error: InputError, path: Path | str, log_format: LogFormat = DEFAULT_FORMAT
) -> InputError:
    """Return `error` with the line of the log in place of the index of the measurement."""
    line = error.row
    if line is not None:
        line = _selected(Path(path), log_format)[0].rows[line][0]
    return InputError(error.message, file=path, key=error.key, row=line, remedy=error.remedy)


def read_groups(
    path: Path | str, columns: Sequence[GroupColumn], log_format: LogFormat = DEFAULT_FORMAT
) -> Indices:
    """Return the group ``(n,)`` of each row of a log, numbered in order of first appearance.

    Parameters
    ----------
    path
        Log file, as for :func:`planopt.channel.read_log`.
    columns
        Grouping columns; at least one.
    log_format
        Format of the log, with its row filter.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, a cell is empty, or a cell of a column with
        blocks is not a number.
    """
    table, _ = _selected(Path(path), log_format)
    labels: dict[tuple[str | int, ...], int] = {}
    found: list[int] = []
    cells = [
        table.cells(each.name) if each.block is None else table.numbers(each.name)
        for each in columns
    ]
    for row in zip(*cells, strict=True):
        key = tuple(
            cell.label() if column.block is None else math.floor(cell.number() / column.block)
            for cell, column in zip(row, columns, strict=True)
        )
        found.append(labels.setdefault(key, len(labels)))
    return np.array(found, dtype=np.intp)


def _selected(source: Source, log_format: LogFormat) -> tuple[LogTable, LogColumns]:
    """Return the rows of a log that pass the format's filter, and the log's columns."""
    table = read_table(source)
    columns = columns_of(table, log_format)
    for name in (columns.x, columns.y, columns.power):
        table.index(name)
    readings = readings_of(table, columns)
    if not readings.rows:
        raise InputError(
            "the file has a header but no rows",
            file=table.file,
            remedy="give a log with at least one measurement",
        )
    return rows_of(readings, log_format), columns


def rows_of(table: LogTable, log_format: LogFormat) -> LogTable:
    """Return the rows of a table that pass the format's filter; raise an error if none does."""
    chosen = table.where(log_format.where)
    if not chosen.rows:
        raise _no_rows(table, log_format)
    return chosen


def _no_rows(table: LogTable, log_format: LogFormat) -> InputError:
    """Return the error for a log without rows that pass the filter."""
    names = [name for name, _ in log_format.where]
    texts = [listed(sorted({cell.text.strip() for cell in table.cells(name)})) for name in names]
    return InputError(
        "no row has " + " and ".join(f"{name}={text}" for name, text in log_format.where),
        file=table.file,
        remedy="; ".join(f"{name} has {has}" for name, has in zip(names, texts, strict=True)),
    )


FEWEST_READINGS = 20  # Minimum number of readings of a transmitter, unless the user names it


def transmitters_of(
    source: Source, column: str, log_format: LogFormat = DEFAULT_FORMAT
) -> dict[str, int]:
    """Return the number of readings of each transmitter named in a column."""
    table, _ = _selected(source, log_format)
    return labels_of(table, column)


def labels_of(table: LogTable, column: str) -> dict[str, int]:
    """Return the number of rows of each label in a column, most frequent first."""
    counts: dict[str, int] = {}
    for cell in table.cells(column):
        label = cell.label()
        counts[label] = counts.get(label, 0) + 1
    return dict(sorted(counts.items(), key=lambda item: -item[1]))
