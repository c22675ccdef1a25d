"""Format of a power log (columns, units, row filter) as keys of problem files and as options."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import Field

from planopt.channel.parameters import Station
from planopt.errors import InputError
from planopt.keys import Decibels, Distance, OriginKey, Part, ReadAs, Table
from planopt.world.geodesy import FARTHEST_M, Origin, east_north_m, require_points

Columns = tuple[str | None, str | None, str | None]
"""Names of the columns for x, y and power; None if the name is detected."""

AXES = ("x", "y", "power")

PowerUnit = Literal["dBm", "mW"]

ColumnName = Annotated[str, Field(min_length=1)]


class ColumnsTable(Table):
    """Table ``columns``: column names of a log; missing ones are detected."""

    x: str | None = Field(default=None, min_length=1)
    """Column of x in metres, or of the longitude."""
    y: str | None = Field(default=None, min_length=1)
    """Column of y in metres, or of the latitude."""
    power: str | None = Field(default=None, min_length=1)
    """Column of received power."""


def _columns_keys(columns: Sequence[str | None]) -> dict[str, Any]:
    if not isinstance(cast("object", columns), tuple) or len(columns) != len(AXES):
        raise InputError(
            f"should be three column names, but is {columns!r}",
            key="channel.measurements.columns",
            remedy="give the names of x, y and power; None for a name that planopt should detect",
        )
    return {axis: name for axis, name in zip(AXES, columns, strict=True) if name is not None}


class WhereKeys(Table):
    """Key for the row filter."""

    where: dict[str, str] = Field(default={})
    """Only rows with these texts are read, such as where = {tx = "AP1"}."""


@dataclass(frozen=True)
class LogFormat(Part):
    """Columns, units and row filter of a power log.

    Omitted columns are detected by the names that known programs use
    (:mod:`planopt.channel.logs.readers`).
    """

    at = "channel.measurements"
    Keys = WhereKeys
    not_keys = frozenset({"where"})

    columns: Annotated[
        Columns, ReadAs(ColumnsTable, attrgetter("x", "y", "power"), tuple, to_keys=_columns_keys)
    ] = (None, None, None)
    """Column names of the log as a table with x, y and power; missing ones are detected."""
    censored_column: ColumnName | None = None
    """Column of the log that marks censored rows: 1 or true if the power is an upper limit."""
    floor_dbm: Decibels | None = None
    """Power in dBm at or below which log entries are censored."""
    time_column: ColumnName | None = None
    """Column of times: seconds, Unix time in s, ms, us or ns, or dates as in ISO 8601."""
    receiver_column: ColumnName | None = None
    """Column of receiver labels; the first label in the log is the reference."""
    resolution_db: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Rounding step of all powers in dB; 0 for none."""
    position_std_m: Distance = 0.0
    """Standard deviation in metres of the position error per coordinate."""
    where: tuple[tuple[str, str], ...] = ()
    """Pairs of a column and a text. Only rows with all these texts are read."""
    origin_deg: OriginKey = None
    """Latitude and longitude in degrees of the origin, and the angle in degrees from east to the x
    axis if it is not 0. If given, positions of the log are degrees (WGS 84) and become metres."""
    accuracy_column: ColumnName | None = None
    """Column of the radius in metres that contains the position with probability 68 %."""
    power_unit: PowerUnit | None = None
    """Unit of the power: dBm or mW; default: inferred from the column's name and values."""
    reader: ColumnName | None = None
    """Name of the program that wrote the log; default: detected."""

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of the table with non-default values."""
        keys = super().to_keys()
        changed = {
            each.name: keys[each.name]
            for each in fields(self)
            if each.name in keys and keys[each.name] != each.default
        }
        if "columns" in changed:
            changed["columns"] = _columns_keys(self.columns)
        return {**changed, "where": dict(self.where)} if self.where else changed

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return field values from the keys of a table; the filter becomes pairs of texts."""
        return {**super().of_keys(table), "where": tuple(table.where.items())}


DEFAULT_FORMAT = LogFormat()


def parse_columns(text: str) -> Columns:
    """Parse column names such as ``x=east,y=north,power=rssi``; omitted ones are None."""
    remedy = "write x=NAME,y=NAME,power=NAME"
    names: dict[str, str] = {}
    for part in text.split(","):
        what, equals, name = (piece.strip() for piece in part.partition("="))
        if what not in AXES or not equals or not name:
            raise InputError(f"cannot read {part!r}", key="columns", remedy=remedy)
        names[what] = name
    return names.get("x"), names.get("y"), names.get("power")


def parse_where(texts: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Parse texts ``COLUMN=TEXT`` to pairs for the field `where` of :class:`LogFormat`."""
    pairs: list[tuple[str, str]] = []
    for text in texts:
        column, equals, value = (piece.strip() for piece in text.partition("="))
        if not column or not equals or not value:
            raise InputError(f"cannot read {text!r}", key="--where", remedy="write COLUMN=VALUE")
        pairs.append((column, value))
    return tuple(pairs)


def parse_station(text: str, origin_deg: Origin | None = None) -> Station | None:
    """Parse ``X,Y[,HEIGHT]``, or given an origin ``LAT,LON[,HEIGHT]``; None for ``unknown``."""
    if text.strip().lower() == "unknown":
        return None
    form = "X,Y[,HEIGHT] in metres" if origin_deg is None else "LAT,LON[,HEIGHT] in degrees"
    remedy = f"write {form}, or the word unknown"
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(math.isfinite(number) for number in numbers):
        raise InputError(
            f"{text!r} is not a position of two or three finite numbers",
            key="--station",
            remedy=remedy,
        )
    place, height_m = np.array(numbers[:2]), (*numbers, 0.0)[2]
    if origin_deg is not None:
        (place,) = east_north_m(place[1:], place[:1], origin_deg)
        if np.isnan(place).any():
            raise InputError(
                f"latitude {numbers[0]:g}, longitude {numbers[1]:g} is more than "
                f"{FARTHEST_M / 1000.0:.0f} km from --origin",
                key="--station",
                remedy=f"{remedy}; metres cannot be used with --origin",
            )
        require_points(text, "--station", "HEIGHT")
    return Station((float(place[0]), float(place[1])), height_m)


@dataclass(frozen=True)
class GroupColumn:
    """Column of a log that defines groups of rows, optionally by blocks of its values."""

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
            remedy="write COLUMN or COLUMN:BLOCK with BLOCK above 0, separated by commas",
        )
    return GroupColumn(name, block)
