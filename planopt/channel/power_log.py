"""Reader of power logs: CSV files of positions and received powers, with columns found by name.

Lines that start with ``#``, empty lines and other columns are ignored. A byte order mark is
accepted. Errors name the line and the column.

Longitudes and latitudes become metres east and north of an origin: positions on the WGS 84
ellipsoid are projected orthogonally onto the tangent plane at the origin. A distance d from the
origin comes out too short by d^3 / (6 R^2), R the earth's radius: 4 mm at 10 km, 4 m at 100 km.

Rows belong to one group if all grouping columns agree: ``day`` for whole days, ``day,t_s:600``
for blocks of 600 in the column ``t_s`` within each day.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurements import LARGEST_POWER_DBM, LEAST_POWER_DBM, Measurements
from planopt.channel.parameters import Station
from planopt.errors import InputError, listed
from planopt.files.reading import read_text
from planopt.keys import LARGEST_COORDINATE_M

DEFAULT_COLUMNS = ("x_m", "y_m", "power_dbm")
"""Default names of the columns for x, y and power."""

LARGEST_LATITUDE_DEG, LARGEST_LONGITUDE_DEG = 90.0, 180.0

RANGES_M = ((-LARGEST_COORDINATE_M, LARGEST_COORDINATE_M, "m"),) * 2
"""Range and unit of x and of y in metres."""

RANGES_DEG = (
    (-LARGEST_LONGITUDE_DEG, LARGEST_LONGITUDE_DEG, "degrees"),
    (-LARGEST_LATITUDE_DEG, LARGEST_LATITUDE_DEG, "degrees"),
)
"""Range and unit of longitude and of latitude."""

POWER_RANGE = (LEAST_POWER_DBM, LARGEST_POWER_DBM, "dBm")

FLAGS = {"1": True, "true": True, "0": False, "false": False}
"""Accepted flags, in lower case; upper case is accepted too."""


@dataclass(frozen=True)
class LogFormat:
    """Columns, units and row filter of a power log.

    Attributes
    ----------
    columns
        Names of the columns for x (m), y (m) and power (dBm).
    censored_column
        Name of a column of flags: 1 or true if the recorded power is only an upper limit.
    floor_dbm
        Sensitivity floor of the receiver. Powers at or below it are left-censored at the floor.
    time_column
        Name of the column of times in seconds.
    receiver_column
        Name of the column of receiver labels; the first label in the log is the reference.
    resolution_db
        Rounding step of all powers; 0 for none.
    position_std_m
        Standard deviation of the position error per coordinate, the same for all positions.
    rows
        Pairs of a column and a text. Only rows with all these texts are read, for example those of
        one transmitter.
    origin_deg
        Latitude and longitude of the origin (0, 0). If set, the columns for x and y contain
        longitudes and latitudes in degrees (WGS 84), which become metres east and north.
    """

    columns: tuple[str, str, str] = DEFAULT_COLUMNS
    censored_column: str | None = None
    floor_dbm: float | None = None
    time_column: str | None = None
    receiver_column: str | None = None
    resolution_db: float = 0.0
    position_std_m: float = 0.0
    rows: tuple[tuple[str, str], ...] = ()
    origin_deg: tuple[float, float] | None = None


def parse_columns(text: str) -> tuple[str, str, str]:
    """Parse column names such as ``x=east,y=north,power=rssi``; omitted ones keep the default."""
    remedy = "write x=NAME,y=NAME,power=NAME"
    names: dict[str, str] = dict(zip(("x", "y", "power"), DEFAULT_COLUMNS, strict=True))
    for part in text.split(","):
        what, equals, name = (piece.strip() for piece in part.partition("="))
        if what not in names or not equals or not name:
            raise InputError(f"cannot read {part!r}", key="columns", remedy=remedy)
        names[what] = name
    return names["x"], names["y"], names["power"]


def parse_rows(texts: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Parse each ``COLUMN=TEXT`` to a pair for `rows` of :class:`LogFormat`."""
    pairs: list[tuple[str, str]] = []
    for text in texts:
        column, equals, value = (piece.strip() for piece in text.partition("="))
        if not column or not equals or not value:
            raise InputError(f"cannot read {text!r}", key="--where", remedy="write COLUMN=VALUE")
        pairs.append((column, value))
    return tuple(pairs)


def parse_origin(text: str) -> tuple[float, float]:
    """Parse ``LAT,LON`` in degrees."""
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        latitude = longitude = math.nan
    if not (abs(latitude) < LARGEST_LATITUDE_DEG and abs(longitude) <= LARGEST_LONGITUDE_DEG):
        raise InputError(
            f"cannot read {text!r}",
            key="--origin",
            remedy="write LAT,LON in degrees, south and west negative",
        )
    return latitude, longitude


EQUATOR_RADIUS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563

FARTHEST_M = 100_000.0
"""Maximum distance from the origin."""


def east_north_m(
    longitude_deg: NDArray[np.float64],
    latitude_deg: NDArray[np.float64],
    origin_deg: tuple[float, float],
) -> NDArray[np.float64]:
    """Project positions onto the tangent plane at the origin; NaN beyond `FARTHEST_M`."""
    # Shapes: longitude_deg, latitude_deg (n,); returns (n, 2).
    latitude, longitude = np.radians(origin_deg)
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    away = _from_the_centre_m(np.radians(longitude_deg), np.radians(latitude_deg))
    away -= _from_the_centre_m(longitude, latitude)
    plane = np.stack([away @ east, away @ np.cross(up, east)], axis=-1)
    plane[np.linalg.norm(away, axis=-1) > FARTHEST_M] = np.nan
    return plane


def _from_the_centre_m(
    longitude: NDArray[np.float64] | np.float64, latitude: NDArray[np.float64] | np.float64
) -> NDArray[np.float64]:
    """Return geocentric coordinates of positions at height zero; ``(..., 3)``."""
    squared_eccentricity = FLATTENING * (2.0 - FLATTENING)
    normal = EQUATOR_RADIUS_M / np.sqrt(1.0 - squared_eccentricity * np.sin(latitude) ** 2)
    return np.stack(
        [
            normal * np.cos(latitude) * np.cos(longitude),
            normal * np.cos(latitude) * np.sin(longitude),
            normal * (1.0 - squared_eccentricity) * np.sin(latitude),
        ],
        axis=-1,
    )


def parse_station(text: str, origin_deg: tuple[float, float] | None = None) -> Station | None:
    """Parse ``X,Y[,HEIGHT]`` in metres, or ``LAT,LON[,HEIGHT]`` with an origin; None if unknown."""
    if text.strip().lower() == "unknown":
        return None
    form = "X,Y[,HEIGHT] in metres" if origin_deg is None else "LAT,LON[,HEIGHT] in degrees"
    remedy = f"write {form}, or unknown"
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(math.isfinite(number) for number in numbers):
        raise InputError(f"cannot read {text!r}", key="station", remedy=remedy)
    place, height_m = np.array(numbers[:2]), (*numbers, 0.0)[2]
    if origin_deg is not None:
        (place,) = east_north_m(place[1:], place[:1], origin_deg)
        if np.isnan(place).any():
            raise InputError(
                f"{text} is more than {FARTHEST_M / 1000.0:.0f} km from --origin",
                key="station",
                remedy=remedy,
            )
    return Station((float(place[0]), float(place[1])), height_m)


DEFAULT_FORMAT = LogFormat()


@dataclass(frozen=True)
class Cell:
    """Cell of a log with its location in the file."""

    text: str
    file: Path
    line: int
    column: str  # Name of its column

    def label(self) -> str:
        """Return the text, or raise an error if it is empty or not printable."""
        cell = self.text.strip()
        if not cell:
            raise self._error("the cell is empty", "fill it, or leave the row out")
        if not cell.isprintable():
            words = f"{cell!a} has a character that cannot be printed"
            raise self._error(words, "write letters, digits and signs")
        return cell

    def number(self) -> float:
        """Return the cell as a finite number."""
        cell = self.label()
        try:
            # Python reads 1_0 as 10.
            number = math.nan if "_" in cell else float(cell)
        except ValueError:
            remedy = "write a number with a decimal point, such as -61.5"
            raise self._error(f"{cell!r} is not a number", remedy) from None
        if not math.isfinite(number):
            remedy = "remove the row, or mark it censored at the receiver's floor"
            raise self._error(f"{cell!r} is not a finite number", remedy)
        return number

    def flag(self) -> bool:
        """Return the cell as a flag."""
        flag = FLAGS.get(self.text.strip().lower())
        if flag is None:
            raise self._error(f"{self.text.strip()!r} is not a flag", "use 0 or 1")
        return flag

    def _error(self, words: str, remedy: str) -> InputError:
        return InputError(words, file=self.file, key=self.column, row=self.line, remedy=remedy)


@dataclass(frozen=True)
class PowerLog:
    """Measurements of a log, in the order of its rows."""

    measurements: Measurements
    # Labels by receiver number, the reference first; empty without a receiver column
    receivers: tuple[str, ...]


def read_log(path: Path | str, log_format: LogFormat = DEFAULT_FORMAT) -> Measurements:
    """Read the measurements of a power log; see :class:`LogFormat` for the options."""
    return read_power_log(path, log_format).measurements


def read_power_log(path: Path | str, log_format: LogFormat = DEFAULT_FORMAT) -> PowerLog:
    """Read the measurements and the receiver labels of a power log."""
    file = Path(path)
    numbered = [*log_format.columns]
    if log_format.time_column is not None:
        numbered.append(log_format.time_column)
    flag, label = log_format.censored_column, log_format.receiver_column
    wanted = [*numbered, *(name for name in (flag, label) if name is not None)]
    lines: list[int] = []
    numbers: list[list[float]] = []
    flags: list[bool] = []
    labels: list[str] = []
    for cells in _read_cells(file, wanted, log_format):
        lines.append(cells[0].line)
        numbers.append([cell.number() for cell in cells[: len(numbered)]])
        if flag is not None:
            flags.append(cells[len(numbered)].flag())
        if label is not None:
            labels.append(cells[-1].label())
    if not numbers:
        raise _no_rows(file, log_format)
    table, count = np.array(numbers), len(numbers)
    power = table[:, 2].copy()
    censored = np.array(flags) if flags else np.zeros(count, dtype=np.bool_)
    if log_format.floor_dbm is not None:
        censored |= power <= log_format.floor_dbm
        power = np.maximum(power, log_format.floor_dbm)
    ranges = (*(RANGES_M if log_format.origin_deg is None else RANGES_DEG), POWER_RANGE)
    for name, values, (least, largest, unit) in zip(
        log_format.columns, (table[:, 0], table[:, 1], power), ranges, strict=True
    ):
        outside = np.flatnonzero((values < least) | (values > largest)).tolist()
        if outside:
            raise InputError(
                f"{values[outside[0]]:g} {unit} is out of range",
                file=file,
                key=name,
                row=lines[outside[0]],
                remedy=f"from {least:g} to {largest:g} {unit}; correct or remove the row",
            )
    positions_m = table[:, :2].copy()
    if log_format.origin_deg is not None:
        positions_m = east_north_m(table[:, 0], table[:, 1], log_format.origin_deg)
        afar = np.flatnonzero(np.isnan(positions_m[:, 0])).tolist()
        if afar:
            raise InputError(
                f"is more than {FARTHEST_M / 1000.0:.0f} km from the origin",
                file=file,
                row=lines[afar[0]],
                remedy="give an origin near the log; x is the longitude, y the latitude",
            )
    # Receivers are numbered by first appearance.
    number_of = {label: number for number, label in enumerate(dict.fromkeys(labels))}
    measurements = Measurements(
        positions_m,
        power,
        censored,
        resolution_db=np.full(count, log_format.resolution_db),
        position_std_m=np.full(count, log_format.position_std_m),
        time_s=table[:, 3].copy() if table.shape[1] > 3 else np.zeros(count),
        receiver=np.array([number_of[each] for each in labels], dtype=np.intp),
    )
    return PowerLog(measurements, tuple(number_of))


def at_file_line(
    error: InputError, path: Path | str, log_format: LogFormat = DEFAULT_FORMAT
) -> InputError:
    """Convert an error about a measurement's index into one about the log's line."""
    line = error.row
    if line is not None:
        line = [*_read_cells(Path(path), log_format.columns, log_format)][line][0].line
    return InputError(error.message, file=path, key=error.key, row=line, remedy=error.remedy)


def _read_cells(file: Path, columns: Sequence[str], log_format: LogFormat) -> Iterator[list[Cell]]:
    """Yield the cells of `columns` for each row that passes the format's filter."""
    rows = _rows(file)
    first = next(rows, None)
    if first is None:
        raise InputError("the file is empty", file=file, remedy="a header and rows are needed")
    header_line, header = first
    if len(header) == 1:
        raise InputError(
            "the first line has one column",
            file=file,
            row=header_line,
            remedy="save the log as CSV: names of columns, then rows, separated by commas",
        )
    names = [name.strip() for name in header]

    def index_of(name: str) -> int:
        if names.count(name) == 1:
            return names.index(name)
        problem = "appears twice" if name in names else "is missing"
        raise InputError(
            f"column {name!r} {problem}; the file has {listed(names)}",
            file=file,
            key=name,
            row=header_line,
            remedy="name columns as the header does; x=NAME,y=NAME,power=NAME for the first three",
        )

    indices = [index_of(name) for name in columns]
    required = [(index_of(name), text) for name, text in log_format.rows]
    for line, cells in rows:
        if len(cells) != len(names):
            raise InputError(
                f"{len(cells)} cells where the header has {len(names)}",
                file=file,
                row=line,
                remedy="give each row as many cells as the header",
            )
        if all(cells[at].strip() == text for at, text in required):
            yield [Cell(cells[at], file, line, names[at]) for at in indices]


def _no_rows(file: Path, log_format: LogFormat) -> InputError:
    """Return the error for a log without rows that pass the filter."""
    if not log_format.rows:
        return InputError(
            "the file has a header but no rows",
            file=file,
            remedy="give a log with at least one measurement",
        )
    columns = [name for name, _ in log_format.rows]
    found = list(_read_cells(file, columns, LogFormat()))
    texts = [listed(sorted({row[at].text.strip() for row in found})) for at in range(len(columns))]
    return InputError(
        "no row has " + " and ".join(f"{name}={text}" for name, text in log_format.rows),
        file=file,
        remedy="; ".join(f"{name} has {has}" for name, has in zip(columns, texts, strict=True)),
    )


def _rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of the header and of every row."""
    text = read_text(file)
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            try:
                yield number, next(csv.reader([stripped], strict=True))
            except csv.Error as error:
                raise InputError(
                    f"not a CSV row: {error}",
                    file=file,
                    row=number,
                    remedy="save the log as CSV with commas",
                ) from error


@dataclass(frozen=True)
class GroupColumn:
    """Grouping column of a log."""

    name: str
    # Block length: numbers in one block, counted from zero, form a group; None: one group per text
    block: float | None = None


def parse_groups(text: str) -> tuple[GroupColumn, ...]:
    """Parse grouping columns ``COLUMN[:BLOCK][,...]``.

    Raises
    ------
    InputError
        The text does not have this form, or a block is not positive.
    """
    return tuple(_group_column(part) for part in text.split(","))


def read_groups(
    path: Path | str, columns: Sequence[GroupColumn], log_format: LogFormat = DEFAULT_FORMAT
) -> NDArray[np.intp]:
    """Return the group label of each row of a log, in order of first appearance; ``(n,)``.

    Parameters
    ----------
    path
        CSV file, as for :func:`planopt.channel.read_log`.
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
    labels: dict[tuple[str | int, ...], int] = {}
    found: list[int] = []
    names = [column.name for column in columns]
    for cells in _read_cells(Path(path), names, log_format):
        key = tuple(
            cell.label() if column.block is None else math.floor(cell.number() / column.block)
            for cell, column in zip(cells, columns, strict=True)
        )
        found.append(labels.setdefault(key, len(labels)))
    return np.array(found, dtype=np.intp)


def _group_column(text: str) -> GroupColumn:
    """Parse ``COLUMN`` or ``COLUMN:BLOCK``."""
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
