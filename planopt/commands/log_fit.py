"""The options and the fit that commands on a power log share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast, get_args

import typer

from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.channel.estimation.channel_fit import ChannelFit, Loss
    from planopt.channel.logs.log_format import LogFormat
    from planopt.channel.measurements import Measurements
    from planopt.channel.parameters import ChannelParameters
    from planopt.channel.station.station_position import StationMethod

LogArgument = Annotated[Path, typer.Argument(metavar="LOG.csv", help="A CSV file with a header.")]
StationOption = Annotated[
    str,
    typer.Option(
        "--station", metavar="X,Y[,HEIGHT]|unknown", help="Position of the base station, in metres."
    ),
]
StationMethodOption = Annotated[
    str | None,
    typer.Option(
        "--station-method",
        metavar="NAME",
        help="How an unknown station is found: joint (likelihood) or line (least squares).",
    ),
]
MethodOption = Annotated[
    str,
    typer.Option(
        "--method", metavar="NAME", help="Estimator: lemma1, capped, convex, nls or reml."
    ),
]
LossOption = Annotated[
    str,
    typer.Option(
        "--loss", metavar="NAME", help="Loss of the method convex: squares, huber or absolute."
    ),
]
ColumnsOption = Annotated[
    str | None,
    typer.Option("--columns", metavar="x=NAME,y=NAME,power=NAME", help="Names of columns."),
]
CensoredOption = Annotated[
    str | None,
    typer.Option(
        "--censored", metavar="COLUMN", help="Column that is 1 where the power is an upper limit."
    ),
]
FloorOption = Annotated[
    float | None,
    typer.Option(
        "--floor", metavar="DBM", help="Receiver sensitivity: powers at or below are upper limits."
    ),
]
ResolutionOption = Annotated[
    float, typer.Option("--resolution", metavar="DB", help="Powers are rounded to this step.")
]
PositionErrorOption = Annotated[
    float,
    typer.Option(
        "--position-error", metavar="M", help="Standard deviation of either coordinate (GPS)."
    ),
]
TimeOption = Annotated[
    str | None,
    typer.Option("--time", metavar="COLUMN", help="Column of measurement times, in seconds."),
]
ForgettingOption = Annotated[
    float | None,
    typer.Option(
        "--forgetting", metavar="S", help="Shadowing changes over this time; needs --time."
    ),
]
ReceiverOption = Annotated[
    str | None,
    typer.Option(
        "--receiver",
        metavar="COLUMN",
        help="Column of receivers: each has an offset to the first in the log.",
    ),
]

WhereOption = Annotated[
    list[str] | None,
    typer.Option(
        "--where",
        metavar="COLUMN=VALUE",
        help="Only rows with this value, such as those of one transmitter; may be repeated.",
    ),
]

OriginOption = Annotated[
    str | None,
    typer.Option(
        "--origin",
        metavar="LAT,LON",
        help="x and y of the log are longitude and latitude; here is (0, 0), in degrees.",
    ),
]


@dataclass(frozen=True)
class LogOptions:
    """The options of a log as they were given; see those."""

    columns: str | None
    censored: str | None
    floor: float | None
    resolution: float
    position_error: float
    time: str | None
    forgetting: float | None
    receiver: str | None
    where: list[str] | None
    origin: str | None


@dataclass(frozen=True)
class LogFit:
    """A log and what it tells."""

    measurements: Measurements  # All of the log
    found: ChannelFit  # Their fit
    receivers: tuple[str, ...]  # Labels by the receivers' numbers; empty without --receiver
    # Estimates the parameters from any measurements as from these
    learn: Callable[[Measurements], ChannelParameters]
    log_format: LogFormat  # How the log was read


def read_and_fit(
    log: Path,
    station: str,
    method: str,
    options: LogOptions,
    loss: str = "squares",
    station_method: str | None = None,
) -> LogFit:
    """Read the log and fit it, everything as it was given on the command line."""
    from planopt.channel.estimation.channel_fit import require_loss, require_method
    from planopt.channel.estimation.fit import fit_channel, fitted_parameters
    from planopt.channel.logs.log_file import at_file_line, parse_station, read_power_log
    from planopt.channel.station.station_search import fit_channel_and_station

    chosen = require_method(method, "--method")
    require_loss(loss, chosen, "--loss")
    rho = cast("Loss", loss)
    site = parse_station(station)
    way = _station_method(station_method, station_is_given=site is not None)
    forgetting_s = _forgetting_s(options)
    log_format = _log_format(options)
    read = read_power_log(log, log_format)

    def find(measurements: Measurements, intervals: bool) -> ChannelFit:
        return fit_channel_and_station(
            measurements,
            chosen,
            forgetting_s=forgetting_s,
            station_method=way,
            loss=rho,
            intervals=intervals,
        )

    def fit(measurements: Measurements) -> ChannelFit:
        if site is None:
            return find(measurements, intervals=True)
        return fit_channel(measurements, site, chosen, forgetting_s, loss=rho)

    def learn(measurements: Measurements) -> ChannelParameters:
        if site is None:
            return find(measurements, intervals=False).parameters
        return fitted_parameters(measurements, site, chosen, forgetting_s, loss=rho)

    try:
        found = fit(read.measurements)
    except InputError as error:
        raise at_file_line(error, log, log_format) from None
    return LogFit(read.measurements, found, read.receivers, learn, log_format)


def _station_method(name: str | None, *, station_is_given: bool) -> StationMethod:
    """Return the method by which the station is found."""
    from planopt.channel.station.station_position import StationMethod

    names = get_args(StationMethod)
    if name is None:
        return "joint"
    if name not in names:
        raise InputError(
            f"{name!r} is no way to find a station",
            key="--station-method",
            remedy=f"use {', '.join(names)}",
        )
    if station_is_given:
        raise InputError(
            "the station is given, so there is nothing to find",
            key="--station-method",
            remedy="leave it out, or say --station unknown",
        )
    return cast("StationMethod", name)


def _log_format(options: LogOptions) -> LogFormat:
    """Return how the log is to be read."""
    from planopt.channel.logs.log_format import (
        DEFAULT_COLUMNS,
        LogFormat,
        parse_columns,
        parse_origin,
        parse_rows,
    )

    for value, key in (
        (options.resolution, "--resolution"),
        (options.position_error, "--position-error"),
    ):
        if not 0.0 <= value < math.inf:
            raise InputError(f"{value!r} cannot be used", key=key, remedy="give 0 or more")
    if options.floor is not None and not math.isfinite(options.floor):
        raise InputError(f"{options.floor!r} cannot be used", key="--floor", remedy="give dBm")
    return LogFormat(
        DEFAULT_COLUMNS if options.columns is None else parse_columns(options.columns),
        options.censored,
        options.floor,
        options.time,
        options.receiver,
        options.resolution,
        options.position_error,
        parse_rows(options.where or ()),
        None if options.origin is None else parse_origin(options.origin),
    )


def _forgetting_s(options: LogOptions) -> float:
    """The forgetting time; infinite where none is given."""
    if options.forgetting is None:
        return math.inf
    if not options.forgetting > 0.0:
        raise InputError(
            f"{options.forgetting!r} cannot be used",
            key="--forgetting",
            remedy="give more than 0 seconds",
        )
    if options.time is None:
        raise InputError(
            "nothing says when the measurements were taken",
            key="--forgetting",
            remedy="name the column of times with --time COLUMN",
        )
    return options.forgetting
