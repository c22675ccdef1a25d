"""Positions of transmitters in a file: a table of names and coordinates, such as OpenCellID's."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from planopt.channel.logs.log_table import Cell, LogTable, alias
from planopt.channel.logs.readers import read_table
from planopt.channel.parameters import Station
from planopt.errors import InputError, listed
from planopt.world.geodesy import Origin, east_north_m


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
