"""Tables of logs in SQLite and Parquet files and in data frames."""

import io
import math
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any, cast

from planopt.channel.logs.log_table import LogTable, is_position
from planopt.errors import InputError
from planopt.files.reading import (
    LARGEST_BINARY_BYTES,
    foreign_reader,
    read_bytes,
    require_array_size,
    require_size,
)

MOST_STEPS = 2_000
"""Maximum instructions of SQLite's virtual machine per megabyte of the file, in thousands."""

LEAST_STEPS = 50_000

Ranked = Callable[[Sequence[str]], int]
"""Function that scores a table by its column names; the best is read, and 0 means no log."""


def read_sqlite(path: Path, rank: Ranked) -> LogTable:
    """Read, from an SQLite file, the table whose column names have the highest `rank`."""
    import sqlite3

    content = read_bytes(path)
    with foreign_reader(path, "an SQLite file"):
        # A copy in memory: the file's own journals are not opened, and nothing can be written.
        connection = sqlite3.connect(":memory:")
        connection.deserialize(content)
        used, most = count(1), LEAST_STEPS + MOST_STEPS * len(content) // 2**20
        connection.set_progress_handler(lambda: next(used) > most, 1000)
        # Views and virtual tables may run any query.
        found = connection.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND sql LIKE 'CREATE TABLE%' "
            "AND name NOT LIKE 'sqlite_%'"
        )
        names = [name for (name,) in found.fetchall() if isinstance(name, str)]
        columns = {name: _columns(connection, name) for name in names}
        chosen = max(names, key=lambda name: rank(columns[name]), default=None)
        if chosen is None or rank(columns[chosen]) == 0:
            raise InputError(
                f"has no table with positions and powers among {', '.join(names) or 'none'}",
                remedy="export the log's table as CSV",
            )
        (rows,) = connection.execute(f"SELECT COUNT(*) FROM {_quoted(chosen)}").fetchone()
        require_array_size(path, chosen, rows, len(columns[chosen]))
        cells = connection.execute(f"SELECT * FROM {_quoted(chosen)}").fetchall()
        connection.close()
    return _table(path, columns[chosen], cells)


def _columns(connection: Any, table: str) -> tuple[str, ...]:
    described = connection.execute(f"SELECT * FROM {_quoted(table)} LIMIT 0").description
    return tuple(column[0] for column in described)


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def read_parquet(path: Path, _: Ranked) -> LogTable:
    """Read a Parquet file; columns that are not text, numbers, flags or dates are left out."""
    try:
        parquet: Any = import_module("pyarrow.parquet")
        kinds: Any = import_module("pyarrow.types")
    except ImportError:
        raise InputError(
            "Parquet cannot be read without pyarrow",
            file=path,
            remedy="install planopt[parquet], or convert the log to CSV",
        ) from None
    content = read_bytes(path)
    with foreign_reader(path, "a Parquet file"):
        file = parquet.ParquetFile(io.BytesIO(content))
        shape = file.metadata
        require_array_size(path, "rows", shape.num_rows, shape.num_columns)
        groups = (shape.row_group(number) for number in range(shape.num_row_groups))
        unpacked = sum(group.total_byte_size for group in groups)
        require_size("declares", unpacked, LARGEST_BINARY_BYTES, path)
        names = [
            field.name
            for field in file.schema_arrow
            if not (kinds.is_nested(field.type) or kinds.is_binary(field.type))
        ]
        columns = [file.read(columns=[name]).column(0).to_pylist() for name in names]
        # Columns of a damaged file may differ in length.
        rows = list(zip(*columns, strict=True))
    return _table(path, names, rows)


def table_of_frame(frame: Any) -> LogTable:
    """Return the table of a data frame of pandas, polars or GeoPandas (points)."""
    try:
        names = [str(name) for name in frame.columns]
        columns = {name: list(frame[name]) for name in names}
    except (AttributeError, TypeError, KeyError):
        raise InputError(
            f"a {type(frame).__name__} is no log",
            key="log",
            remedy="give the name of a file or a DataFrame",
        ) from None
    if hasattr(frame, "geometry") and hasattr(frame, "crs"):
        # The points replace position columns.
        points = frame.geometry
        if not (points.geom_type == "Point").all():
            raise InputError(
                "has geometries that are no points",
                key="geometry",
                remedy="give one point for each reading",
            )
        x, y = "x_m", "y_m"
        if frame.crs is not None:
            # Any reference system is converted to degrees; the user gives --origin for these.
            points, x, y = points.to_crs(4326), "longitude", "latitude"
        left = {name: values for name, values in columns.items() if not is_position(name)}
        left.pop(str(points.name), None)
        columns = {x: list(points.x), y: list(points.y), **left}
    return _table(None, list(columns), list(zip(*columns.values(), strict=True)))


def _table(path: Path | None, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> LogTable:
    """Return a table of text cells; rows count from 1."""
    cells = [(number, [_text(value) for value in row]) for number, row in enumerate(rows, start=1)]
    return LogTable(path, tuple(names), cells, header_line=None)


def _text(value: Any) -> str:
    """Return a value as the text of a cell; empty if there is none."""
    if value is None or isinstance(value, bytes):
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime):
        return "" if str(value) == "NaT" else value.isoformat()
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(float(value))
    return str(cast("object", value))
