"""The format of a power log: its columns' names, the rows that count, and values for all rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from planopt.errors import InputError

DEFAULT_COLUMNS = ("x_m", "y_m", "power_dbm")
"""Names of the columns for x, y and power."""

LARGEST_LATITUDE_DEG, LARGEST_LONGITUDE_DEG = 90.0, 180.0


@dataclass(frozen=True)
class LogFormat:
    """The format of a log: its columns, units and flags.

    Attributes
    ----------
    columns
        Names of the columns for x (m), y (m) and power (dBm).
    censored_column
        Column of flags, 1 or true where the power is only known to be at most the given one.
    floor_dbm
        The receiver's floor: powers at or below it are censored, and count as at most the floor.
    time_column
        Column of times in seconds.
    receiver_column
        Column of the receivers' labels; the first label in the log is the reference.
    resolution_db
        Step that all powers are rounded to; 0 for none.
    position_std_m
        Deviation of the error of either coordinate, of all positions.
    rows
        Pairs of a column and a text: only rows that have all these texts count, such as those of
        one of several transmitters.
    origin_deg
        Latitude and longitude of the place (0, 0). Where it is given, the columns for x and y have
        longitudes and latitudes in degrees (WGS 84), which become metres to the east and north.
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
    """Read ``x=east,y=north,power=rssi``; what is not named keeps its default."""
    remedy = "write x=NAME,y=NAME,power=NAME"
    names: dict[str, str] = dict(zip(("x", "y", "power"), DEFAULT_COLUMNS, strict=True))
    for part in text.split(","):
        what, equals, name = (piece.strip() for piece in part.partition("="))
        if what not in names or not equals or not name:
            raise InputError(f"cannot read {part!r}", key="columns", remedy=remedy)
        names[what] = name
    return names["x"], names["y"], names["power"]


def parse_rows(texts: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Read ``COLUMN=TEXT`` of each, into what :class:`LogFormat` calls `rows`."""
    pairs: list[tuple[str, str]] = []
    for text in texts:
        column, equals, value = (piece.strip() for piece in text.partition("="))
        if not column or not equals or not value:
            raise InputError(f"cannot read {text!r}", key="--where", remedy="write COLUMN=VALUE")
        pairs.append((column, value))
    return tuple(pairs)


def parse_origin(text: str) -> tuple[float, float]:
    """Read ``LAT,LON`` in degrees."""
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
