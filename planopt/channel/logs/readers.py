"""Known logging programs, detection of columns by name, and readers of file formats."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planopt.channel.logs.bag_table import is_recording, read_recording
from planopt.channel.logs.binary_tables import Ranked, read_parquet, read_sqlite, table_of_frame
from planopt.channel.logs.log_format import LogFormat
from planopt.channel.logs.log_table import Cell, LogTable, alias, fold, read_delimited
from planopt.channel.measurements import Frame
from planopt.channel.parameters import Station
from planopt.errors import InputError, listed
from planopt.parts import Registry
from planopt.world.geodesy import Origin, east_north_m

PROGRAMS = "planopt.channel.logs.programs"

READERS = Registry(
    "a log reader",
    "reader",
    {
        "wigle": f"{PROGRAMS}:WIGLE",
        "cellmapper": f"{PROGRAMS}:CELLMAPPER",
        "network_survey_gsm": f"{PROGRAMS}:GSM",
        "network_survey_umts": f"{PROGRAMS}:UMTS",
        "network_survey_lte": f"{PROGRAMS}:LTE",
        "network_survey_nr": f"{PROGRAMS}:NR",
        "network_survey_wifi": f"{PROGRAMS}:WIFI",
        "network_survey_bluetooth": f"{PROGRAMS}:BLUETOOTH",
        # If two signatures of equal length match, the first one is used.
        "meshtastic": f"{PROGRAMS}:RSSI",
        "meshtastic_snr": f"{PROGRAMS}:SNR",
        "wifi_logger": f"{PROGRAMS}:WIFI_LOGGER",
        "recording": f"{PROGRAMS}:METRES",
        "recording_gps": f"{PROGRAMS}:DEGREES",
    },
    "planopt.log_readers",
)
"""Registry of readers for the logs of known programs."""

KINDS: dict[str, Callable[[Path, Ranked], LogTable]] = {
    **dict.fromkeys((".db", ".sqlite", ".sqlite3", ".db3"), read_sqlite),
    **dict.fromkeys((".parquet", ".pq"), read_parquet),
}
"""Readers of binary files by file extension; all others are text."""


@dataclass(frozen=True)
class LogReader:
    """Declaration of a program's logs; rows without a position or power are skipped."""

    summary: str  # For the documentation
    signature: tuple[str, ...]  # Columns that identify the program
    x: str  # Column of x in metres, or of the longitude
    y: str  # Column of y in metres, or of the latitude
    power: str
    in_degrees: bool = True
    transmitter: str | None = None
    time: str | None = None
    accuracy: str | None = None
    preamble: str | None = None  # Start of lines above the header
    no_power: tuple[str, ...] = ()  # Texts that mean no reading
    remark: str | None = None  # Warning about the meaning or limits of the columns


@dataclass(frozen=True)
class LogColumns:
    """Columns of a log by role; None for a role without a column."""

    x: str
    y: str
    power: str
    in_degrees: bool
    transmitter: str | None
    time: str | None
    accuracy: str | None
    reader_name: str | None
    reader: LogReader | None


DEGREES = ("longitude", "latitude")


def read_table(source: Path | str | Frame) -> LogTable:
    """Read the table of a log: a file by its extension, or a data frame."""
    if not isinstance(source, Path | str):
        return table_of_frame(source)
    path = Path(source)
    if is_recording(path):
        return read_recording(path)
    read = KINDS.get(path.suffix.lower())
    if read is not None:
        return read(path, _likeness)
    preambles = [each.preamble for each in known_readers().values() if each.preamble]
    return read_delimited(path, preambles)


def known_readers() -> dict[str, LogReader]:
    """Return the declarations of all known programs by name."""
    return {name: READERS.find(name) for name in READERS.names()}


def _likeness(names: Sequence[str]) -> int:
    """Score how well column names match those of a log; known programs score highest."""
    table = LogTable(None, tuple(names), ())
    known = [len(each.signature) for each in known_readers().values() if _is_of(table, each)]
    roles = [("x", "y"), ("longitude", "latitude")]
    placed = any(all(alias(table, role) for role in pair) for pair in roles)
    return 10 * max(known, default=0) + int(placed and alias(table, "power") is not None)


def columns_of(table: LogTable, log_format: LogFormat) -> LogColumns:
    """Return the columns of a log, from its format, a known program, or their names."""
    name, reader = _reader_of(table, log_format) or (None, None)
    x, y, power = log_format.columns
    if reader is not None:
        own = (_named(table, each) for each in (reader.x, reader.y, reader.power))
        x, y, power = (given or each for given, each in zip((x, y, power), own, strict=True))
    # A program's optional columns may be missing in older versions.
    time, accuracy, transmitter = (
        None if each is None or fold(each) not in table.folded else table.folded[fold(each)]
        for each in (
            (None, None, None)
            if reader is None
            else (reader.time, reader.accuracy, reader.transmitter)
        )
    )
    if x is None or y is None:
        degrees = [alias(table, role) for role in DEGREES]
        metres = [alias(table, role) for role in ("x", "y")]
        in_degrees = None not in degrees and (
            log_format.origin_deg is not None or (None in metres and x is None and y is None)
        )
        found = degrees if in_degrees else metres
        # An undetected column is reported as missing by its usual name.
        x, y = x or found[0] or "x_m", y or found[1] or "y_m"
    else:
        in_degrees = log_format.origin_deg is not None or (
            reader is not None and reader.in_degrees and log_format.columns[:2] == (None, None)
        )
    if in_degrees and log_format.origin_deg is None:
        raise InputError(
            f"the positions in columns {x} and {y} are in degrees, but planopt needs metres "
            "from an origin",
            file=table.file,
            key="origin_deg",
            row=table.header_line,
            remedy="give the latitude and longitude of the origin: --origin LAT,LON, or origin_deg",
        )
    return LogColumns(
        x,
        y,
        power or alias(table, "power") or "power_dbm",
        in_degrees,
        transmitter or alias(table, "transmitter"),
        log_format.time_column or time,
        log_format.accuracy_column or accuracy,
        name,
        reader,
    )


def _named(table: LogTable, name: str) -> str:
    """Return the name of the column that matches `name` regardless of case."""
    return table.folded.get(fold(name), name)


def _is_of(table: LogTable, reader: LogReader) -> bool:
    """Return True if a table has the columns that identify the reader's program."""
    has = {fold(name) for name in table.names}
    return {fold(name) for name in reader.signature} <= has


def _reader_of(table: LogTable, log_format: LogFormat) -> tuple[str, LogReader] | None:
    """Return name and declaration of the program that wrote a log; None if it is unknown."""
    if log_format.reader is not None:
        return log_format.reader, READERS.find(log_format.reader)
    fitting = [item for item in known_readers().items() if _is_of(table, item[1])]
    return max(fitting, key=lambda item: len(item[1].signature), default=None)


def readings_of(table: LogTable, columns: LogColumns) -> LogTable:
    """Return the table without rows that lack position or power, if a known program wrote it."""
    reader = columns.reader
    if reader is None:
        return table
    x, y, power = (table.index(name) for name in (columns.x, columns.y, columns.power))
    kept = [
        (line, cells)
        for line, cells in table.rows
        if all(cells[at].strip() for at in (x, y, power))
        and cells[power].strip() not in reader.no_power
        and not (columns.in_degrees and _is_zero(cells[x]) and _is_zero(cells[y]))
    ]
    return replace(table, rows=kept)


def _is_zero(text: str) -> bool:
    """Return True for a zero coordinate: programs write zeros before the first position fix."""
    return not text.strip().strip("+-0.,")


def read_stations(
    path: Path, labels: Iterable[str], origin_deg: Origin | None = None
) -> dict[str, Station]:
    """Read the positions of transmitters by label; labels that the file lacks are omitted."""
    table, wanted = read_table(path), set(labels)
    label = alias(table, "transmitter") or alias(table, "name")
    in_degrees = origin_deg is not None and alias(table, "latitude") is not None
    roles = ("longitude", "latitude") if in_degrees else ("x", "y")
    names = [alias(table, role) for role in roles]
    if label is None or None in names:
        missing = "names of transmitters" if label is None else " and ".join(roles)
        degrees = alias(table, "latitude") is not None and origin_deg is None
        raise InputError(
            f"has no columns of {missing}; the file has {listed(table.names)}",
            file=path,
            row=table.header_line,
            remedy="give --origin LAT,LON, since positions are in degrees"
            if degrees
            else "name them as in name,x_m,y_m or bssid,lat,lon",
        )
    height = alias(table, "height")
    used = [name for name in (*names, height) if name is not None]
    found: dict[str, Station] = {}
    for cells in _rows(table, label, used):
        key = cells[0].text.strip()
        if key not in wanted:
            continue
        x, y = (cell.number() for cell in cells[1:3])
        station = _station(x, y, cells[3:], origin_deg if in_degrees else None, cells[1])
        if found.setdefault(key, station) != station:
            raise cells[0].error(f"{key!r} has several positions", "keep one row for each")
    return found


def _rows(table: LogTable, label: str, used: list[str]) -> Iterable[tuple[Cell, ...]]:
    return zip(table.cells(label), *(table.numbers(name) for name in used), strict=True)


def _station(
    x: float, y: float, height: tuple[Cell, ...], origin_deg: Origin | None, cell: Cell
) -> Station:
    height_m = height[0].number() if height and height[0].text.strip() else 0.0
    if origin_deg is None:
        return Station((x, y), height_m)
    (place,) = east_north_m(np.array([x]), np.array([y]), origin_deg)
    if not np.isfinite(place).all():
        raise cell.error("is too far from the origin", "give an origin near the stations")
    return Station((float(place[0]), float(place[1])), height_m)
