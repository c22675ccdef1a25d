"""What commands on a power log share: their options, and the fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast, get_args

import typer

from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.channel.fit import ChannelFit, FitMethod
    from planopt.channel.measurements import Measurements

LogArgument = Annotated[Path, typer.Argument(metavar="LOG.csv", help="A CSV file with a header.")]
StationOption = Annotated[
    str, typer.Option("--station", metavar="X,Y[,HEIGHT]|unknown", help="In metres.")
]
MethodOption = Annotated[
    str, typer.Option("--method", metavar="NAME", help="seed, capped, convex, nls or reml.")
]
ColumnsOption = Annotated[
    str | None,
    typer.Option("--columns", metavar="x=NAME,y=NAME,power=NAME", help="Names of columns."),
]
CensoredOption = Annotated[
    str | None,
    typer.Option("--censored", metavar="COLUMN", help="1 where power is an upper limit."),
]
FloorOption = Annotated[
    float | None,
    typer.Option("--floor", metavar="DBM", help="Powers at or below are upper limits."),
]


def read_and_fit(
    log: Path,
    station: str,
    method: str,
    columns: str | None,
    censored: str | None,
    floor: float | None,
) -> tuple[Measurements, ChannelFit]:
    """Read the log and fit it, everything as it was given on the command line.

    Raises
    ------
    InputError
        An option or the log cannot be used; errors about a measurement name its line.
    """
    from planopt.channel.fit import FitMethod, fit_channel
    from planopt.channel.log_file import (
        DEFAULT_COLUMNS,
        at_file_line,
        parse_columns,
        parse_station,
        read_log,
    )
    from planopt.channel.station_search import fit_channel_and_station

    if method not in get_args(FitMethod):
        raise InputError(
            f"{method!r} is no method",
            key="--method",
            remedy=f"use {', '.join(get_args(FitMethod))}",
        )
    chosen = cast("FitMethod", method)
    site = parse_station(station)
    names = DEFAULT_COLUMNS if columns is None else parse_columns(columns)
    measurements = read_log(log, names, censored, floor)
    try:
        if site is None:
            return measurements, fit_channel_and_station(measurements, chosen)
        return measurements, fit_channel(measurements, site, chosen)
    except InputError as error:
        raise at_file_line(error, log) from None
