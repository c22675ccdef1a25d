"""Table of a log: text cells with their lines, common column names, delimited text."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from planopt.errors import InputError, listed
from planopt.files.reading import read_text

DELIMITERS = (",", ";", "\t", "|")
"""Delimiters in order of preference; blanks count if none of these occurs."""
BLANKS = " "  # Delimiter of columns that are separated by any number of blanks
SAMPLED_LINES = 20  # Number of lines used to detect the delimiter
EXCEL_DELIMITER = re.compile(r"sep=(.)", re.IGNORECASE)
"""First line that Excel writes to declare the delimiter."""

DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")

FLAGS = {"1": True, "true": True, "0": False, "false": False}
"""Accepted texts of flags; case is ignored."""


@dataclass(frozen=True)
class Cell:
    """Cell of a log with its line and column."""

    text: str
    file: Path | None  # None for a table in Python
    line: int
    column: str  # Name of its column

    def label(self) -> str:
        """Return the text, or raise an error if it is empty or not printable."""
        cell = self.text.strip()
        if not cell:
            raise self.error("is empty", "fill the cell, or remove the row")
        if not cell.isprintable():
            words = f"{cell!a} has a character that cannot be printed"
            raise self.error(words, "use printable characters only")
        return cell

    def number(self) -> float:
        """Return the cell as a finite number."""
        cell = self.label()
        try:
            # Python reads 1_0 as 10.
            number = math.nan if "_" in cell else float(cell)
        except ValueError:
            remedy = "write a number such as -61.5"
            raise self.error(f"{cell!r} is not a number", remedy) from None
        if not math.isfinite(number):
            remedy = "give a finite number, or remove the row"
            raise self.error(f"{cell!r} is not a finite number", remedy)
        return number

    def flag(self) -> bool:
        """Return the cell as a boolean."""
        flag = FLAGS.get(self.text.strip().lower())
        if flag is None:
            raise self.error(f"{self.text.strip()!r} is not a Boolean", "use 0 or 1")
        return flag

    def error(self, words: str, remedy: str) -> InputError:
        """Return an error about the cell."""
        return InputError(words, file=self.file, key=self.column, row=self.line, remedy=remedy)


@dataclass(frozen=True)
class LogTable:
    """Named columns of text cells."""

    file: Path | None  # None for a table in Python
    names: tuple[str, ...]
    rows: Sequence[tuple[int, Sequence[str]]]  # Line number and cells
    header_line: int | None = 1
    delimiter: str = ","

    def index(self, name: str) -> int:
        """Return the index of a column; raise an error if it is missing or not unique."""
        if self.names.count(name) == 1:
            return self.names.index(name)
        problem = "names several columns" if name in self.names else "is not a column"
        raise InputError(
            f"{problem}; the columns are {listed(self.names)}",
            file=self.file,
            key=name,
            row=self.header_line,
            remedy="use the names in the header; --columns x=NAME,y=NAME,power=NAME names position "
            "and power",
        )

    def cells(self, name: str) -> list[Cell]:
        """Return the cells of a column."""
        at = self.index(name)
        return [Cell(cells[at], self.file, line, name) for line, cells in self.rows]

    def numbers(self, name: str) -> list[Cell]:
        """Return the cells of a numeric column, with decimal commas replaced by points."""
        cells = self.cells(name)
        commas = [cell for cell in cells if DECIMAL_COMMA.fullmatch(cell.text.strip())]
        if not commas:
            return cells
        points = next((cell for cell in cells if "." in cell.text), None)
        if points is not None:
            raise commas[0].error(
                f"{commas[0].text.strip()!r} has a decimal comma, but {points.text.strip()!r} "
                f"in line {points.line} has a point",
                "write all numbers with a decimal point and no thousands separator",
            )
        return [
            Cell(cell.text.replace(",", "."), cell.file, cell.line, cell.column) for cell in cells
        ]

    def where(self, pairs: Sequence[tuple[str, str]]) -> LogTable:
        """Return the table of the rows that match all pairs of column and text."""
        wanted = [(self.index(name), text) for name, text in pairs]
        kept = [
            (line, cells)
            for line, cells in self.rows
            if all(cells[at].strip() == text for at, text in wanted)
        ]
        return LogTable(self.file, self.names, kept, self.header_line, self.delimiter)

    @cached_property
    def folded(self) -> dict[str, str]:
        """Return the column names, keyed by their reduced form (:func:`fold`)."""
        return {fold(name): name for name in reversed(self.names)}


UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue"})


def fold(name: str) -> str:
    """Return a name reduced to lower-case letters and digits, without umlauts."""
    plain = name.casefold().translate(UMLAUTS)
    return "".join(letter for letter in plain if letter.isalnum())


def read_delimited(path: Path, preambles: Sequence[str] = ()) -> LogTable:
    """Read a table of delimited text; lines before the header may start with any of `preambles`."""
    lines = list(_lines(read_text(path), tuple(preambles)))
    named = EXCEL_DELIMITER.fullmatch(lines[0][1]) if lines else None
    if named is not None:
        lines = lines[1:]
    if not lines:
        raise InputError(
            "the file is empty",
            file=path,
            remedy="give a CSV file with a header and one row for each measurement",
        )
    delimiter = named[1] if named is not None else _delimiter_of([line for _, line in lines])
    rows = _split(path, lines, delimiter)
    header_line, header = next(rows)
    if len(header) == 1:
        raise InputError(
            "the header has only one column",
            file=path,
            row=header_line,
            remedy="save the log as CSV: a line with column names, then the rows, separated by "
            "commas",
        )
    names = tuple(name.strip() for name in header)
    return LogTable(path, names, list(_complete(path, rows, len(names))), header_line, delimiter)


def _lines(text: str, preambles: tuple[str, ...]) -> Iterator[tuple[int, str]]:
    """Yield line number and text of the header and of each row."""
    begun = False
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        # Tabs at the end of a line are empty cells.
        stripped = line.strip(" \r\n\v\f")
        if not stripped.strip() or stripped.startswith("#"):
            continue
        if not begun and preambles and stripped.startswith(preambles):
            continue
        begun = True
        yield number, stripped


def _delimiter_of(lines: Sequence[str]) -> str:
    """Return the delimiter that splits the header and sampled rows into equally many cells."""
    sample = lines[:SAMPLED_LINES]
    counts = {each: [_count(line, each) for line in sample] for each in DELIMITERS}
    found = [each for each in DELIMITERS if counts[each][0] > 1]
    even = [each for each in found if len(set(counts[each])) == 1]
    if not found:
        return BLANKS
    return max(even or found, key=lambda each: counts[each][0])


def _count(line: str, delimiter: str) -> int:
    try:
        return len(next(csv.reader([line], delimiter=delimiter, strict=True)))
    except csv.Error:
        return 0


def _split(
    path: Path, lines: Sequence[tuple[int, str]], delimiter: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each line."""
    for number, line in lines:
        if delimiter == BLANKS:
            yield number, line.split()
            continue
        try:
            yield number, next(csv.reader([line], delimiter=delimiter, strict=True))
        except csv.Error as error:
            raise InputError(
                f"not a CSV row: {error}",
                file=path,
                row=number,
                remedy="save the log as CSV with commas",
            ) from error


def _complete(
    path: Path, rows: Iterator[tuple[int, list[str]]], count: int
) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows; raise an error if a row and the header differ in their number of cells."""
    for line, cells in rows:
        if len(cells) != count:
            raise InputError(
                f"the row has {len(cells)} cells, but the header has {count}",
                file=path,
                row=line,
                remedy="give each row as many cells as the header has",
            )
        yield line, cells


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
        "rxrssi level powermw strength pegel empfangspegel",
        "transmitter": "bssid ap mac tx txid transmitter transmitterid anchor beacon gateway "
        "gatewayid accesspoint cellid cell cid pci ssid station node from source sender",
        "name": "name id label",
        "height": "heightm height zm z antennaheight elevation",
        "time": "ts t time timestamp times datetime zeit date unixtime devicetime firstseen stamp",
    }.items()
}
"""Known names of columns by role, in lower case letters and digits, in order of preference."""


def alias(table: LogTable, role: str) -> str | None:
    """Return the column whose name is a known alias of this role, or None."""
    found = next((each for each in ALIASES[role] if each in table.folded), None)
    return None if found is None else table.folded[found]


def is_position(name: str) -> bool:
    """Return True if a column is named like a coordinate."""
    return any(fold(name) in ALIASES[role] for role in ("x", "y", "longitude", "latitude"))
