"""Programs whose logs are known, detection of columns by name, and kinds of files.

A reader is a declaration in :mod:`planopt.channel.logs.programs`; its name in `READERS` is the only
other entry that it needs. A package adds readers by the entry-point group ``planopt.log_readers``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from planopt.channel.logs.log_format import LogFormat
from planopt.channel.logs.log_table import LogTable, fold, read_delimited
from planopt.errors import InputError
from planopt.parts import Registry

PROGRAMS = "planopt.channel.logs.programs"

READERS = Registry("a log reader", "reader", {}, "planopt.log_readers")
"""Readers of the logs of known programs."""


@dataclass(frozen=True)
class LogReader:
    """Declaration of the logs that a program writes."""

    name: str
    summary: str  # One sentence for the documentation
    signature: tuple[str, ...]  # Columns that identify the program
    x: str  # Column of x in metres, or of the longitude
    y: str  # Column of y in metres, or of the latitude
    power: str
    in_degrees: bool = True
    transmitter: str | None = None
    time: str | None = None
    accuracy: str | None = None
    preamble: str | None = None  # Start of lines above the header
    is_reading: Callable[[dict[str, str]], bool] | None = None  # Whether a row has a position
    remark: str | None = None  # Warning about what the log does not contain


@dataclass(frozen=True)
class LogColumns:
    """Columns of a log by role; None if there are none."""

    x: str
    y: str
    power: str
    in_degrees: bool
    transmitter: str | None
    time: str | None
    accuracy: str | None
    reader: LogReader | None


ALIASES = {
    role: tuple(names.split())
    for role, names in {
        "longitude": "lon lng long longitude gpslon gpslongitude lond londeg longitudedeg rxlong "
        "rxlon currentlongitude laenge laengengrad",
        "latitude": "lat latitude gpslat gpslatitude latd latdeg latitudedeg rxlat currentlatitude "
        "breite breitengrad",
        "x": "xm x posx positionx east eastm easting mapx odomx posex posepositionx xposition "
        "localx",
        "y": "ym y posy positiony north northm northing mapy odomy posey posepositiony yposition "
        "localy",
        "power": "powerdbm power rssidbm rssi rsrpdbm rsrp signaldbm signal signallevel "
        "signalstrength signalstrengthdbm dbm rxpower rxpowerdbm rxlev rss rssdbm receivedpower "
        "rxrssi level powermw strength",
        "transmitter": "bssid ap mac tx txid transmitter transmitterid anchor beacon gateway "
        "gatewayid accesspoint cellid cell cid pci ssid station node from source",
        "time": "ts t time timestamp times datetime zeit date unixtime devicetime firstseen stamp",
    }.items()
}
"""Known names of columns by role, in lower case letters and digits, in order of preference."""

DEGREES = ("longitude", "latitude")


def read_table(path: Path) -> LogTable:
    """Read the table of a log file with the reader of its kind of file."""
    return read_delimited(path, [each.preamble for each in known_readers() if each.preamble])


def known_readers() -> Iterator[LogReader]:
    """Yield the declarations of all known programs."""
    return (READERS.find(name) for name in READERS.names())


def columns_of(table: LogTable, log_format: LogFormat) -> LogColumns:
    """Return the columns of a log: those of the format, else of a known program, else by name."""
    reader = _reader_of(table, log_format)
    has = set(table.names)
    x, y, power = log_format.columns
    if reader is not None:
        x, y, power = x or reader.x, y or reader.y, power or reader.power
    # A program's optional columns may be missing in older versions.
    time, accuracy, transmitter = (
        name if name in has else None
        for name in (
            (None, None, None)
            if reader is None
            else (reader.time, reader.accuracy, reader.transmitter)
        )
    )
    if x is None or y is None:
        in_degrees, x, y = _position_columns(table, log_format, x, y)
    else:
        in_degrees = log_format.origin_deg is not None or (
            reader is not None and reader.in_degrees and log_format.columns[:2] == (None, None)
        )
    if in_degrees and log_format.origin_deg is None:
        raise InputError(
            f"columns {x} and {y} are in degrees",
            file=table.file,
            key="origin_deg",
            row=table.header_line,
            remedy="give the origin of the map with --origin LAT,LON or origin_deg",
        )
    return LogColumns(
        x,
        y,
        power or alias(table, "power") or "power_dbm",
        in_degrees,
        transmitter or alias(table, "transmitter"),
        log_format.time_column or time,
        log_format.accuracy_column or accuracy,
        reader,
    )


def _position_columns(
    table: LogTable, log_format: LogFormat, x: str | None, y: str | None
) -> tuple[bool, str, str]:
    """Return whether positions are in degrees, and their columns; metres are preferred."""
    degrees = [alias(table, role) for role in DEGREES]
    metres = [alias(table, role) for role in ("x", "y")]
    in_degrees = None not in degrees and (
        log_format.origin_deg is not None or (None in metres and x is None and y is None)
    )
    found = degrees if in_degrees else metres
    # An undetected column is reported as missing by its usual name.
    return in_degrees, x or found[0] or "x_m", y or found[1] or "y_m"


def alias(table: LogTable, role: str) -> str | None:
    """Return the column of a role by its name; None if there is none."""
    found = next((each for each in ALIASES[role] if each in table.folded), None)
    return None if found is None else table.folded[found]


def _reader_of(table: LogTable, log_format: LogFormat) -> LogReader | None:
    """Return the program that wrote a log; None if it is unknown."""
    if log_format.reader is not None:
        return READERS.find(log_format.reader)
    has = {fold(name) for name in table.names}
    fitting = [each for each in known_readers() if {fold(name) for name in each.signature} <= has]
    return max(fitting, key=lambda each: len(each.signature), default=None)


def readings_of(table: LogTable, columns: LogColumns) -> LogTable:
    """Return the rows that are readings of a known program; those without a position are not."""
    reader = columns.reader
    if reader is None or reader.is_reading is None:
        return table
    kept = [
        (line, cells)
        for line, cells in table.rows
        if reader.is_reading(dict(zip(table.names, cells, strict=True)))
    ]
    return replace(table, rows=kept)
