"""The options and the fit that commands on a power log share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.channel.estimation.channel_fit import ChannelFit, Loss
    from planopt.channel.estimation.station_fit import StationMethod
    from planopt.channel.measurements import Measurements
    from planopt.channel.parameters import ChannelParameters
    from planopt.channel.power_log import LogFormat

DEGENERATE = 3
"""Exit code if the log does not determine the channel."""


def _option(name: str, metavar: str, text: str) -> Any:
    return typer.Option(name, metavar=metavar, help=text)


@dataclass(frozen=True, kw_only=True)
class LogOptions:
    """The options of every command on a power log, as given."""

    log: Annotated[Path, typer.Argument(metavar="LOG.csv", help="A CSV file with a header.")]
    station: Annotated[
        str,
        _option(
            "--station",
            "X,Y[,HEIGHT]|unknown",
            "Position of the base station in metres; with --origin LAT,LON[,HEIGHT].",
        ),
    ]
    method: Annotated[
        str, _option("--method", "NAME", "Estimator: lemma1, capped, convex, nls or reml.")
    ] = "reml"
    station_method: Annotated[
        str | None,
        _option(
            "--station-method",
            "NAME",
            "How an unknown station is found: joint (likelihood) or line (least squares).",
        ),
    ] = None
    columns: Annotated[
        str | None, _option("--columns", "x=NAME,y=NAME,power=NAME", "Names of columns.")
    ] = None
    censored: Annotated[
        str | None,
        _option("--censored", "COLUMN", "Column that is 1 where the power is an upper limit."),
    ] = None
    floor: Annotated[
        float | None,
        _option("--floor", "DBM", "Receiver sensitivity: powers at or below are upper limits."),
    ] = None
    resolution: Annotated[
        float, _option("--resolution", "DB", "Powers are rounded to this step.")
    ] = 0.0
    position_error: Annotated[
        float, _option("--position-error", "M", "Standard deviation of either coordinate (GPS).")
    ] = 0.0
    time: Annotated[
        str | None, _option("--time", "COLUMN", "Column of measurement times, in seconds.")
    ] = None
    forgetting: Annotated[
        float | None,
        _option("--forgetting", "S", "Shadowing changes over this time; needs --time."),
    ] = None
    receiver: Annotated[
        str | None,
        _option(
            "--receiver", "COLUMN", "Column of receivers: each has an offset to the first one."
        ),
    ] = None
    where: Annotated[
        list[str] | None,
        _option(
            "--where",
            "COLUMN=VALUE",
            "Only rows with this value, such as those of one transmitter; may be repeated.",
        ),
    ] = None
    origin: Annotated[
        str | None,
        _option(
            "--origin",
            "LAT,LON",
            "x and y of the log are longitude and latitude; (0, 0) is here, in degrees.",
        ),
    ] = None
    loss: Annotated[
        str, _option("--loss", "NAME", "Loss of the method convex: squares, huber or absolute.")
    ] = "squares"


@dataclass(frozen=True)
class LogFit:
    """A log and the channel fitted to it."""

    measurements: Measurements  # All of the log
    found: ChannelFit  # Their fit
    receivers: tuple[str, ...]  # Labels by the receivers' numbers; empty without --receiver
    # Estimates the parameters from any measurements as from these
    learn: Callable[[Measurements], ChannelParameters]
    log_format: LogFormat  # How the log was read
    warnings: tuple[str, ...]  # Of the fit, and of values that are implausible

    @property
    def exit_code(self) -> int:
        """Return 0, or `DEGENERATE` if the log does not determine the channel."""
        return DEGENERATE if self.found.status == "degenerate" else 0


def read_and_fit(options: LogOptions) -> LogFit:
    """Read a log and fit the channel."""
    from planopt.channel.estimation.channel_fit import require_loss, require_method
    from planopt.channel.estimation.fit import fit_channel, fitted_parameters
    from planopt.channel.estimation.station_fit import fit_channel_and_station
    from planopt.channel.power_log import at_file_line, parse_station, read_power_log
    from planopt.problems.plausibility import log_warnings

    chosen = require_method(options.method, "--method")
    require_loss(options.loss, chosen, "--loss")
    loss = cast("Loss", options.loss)
    log_format = _log_format(options)
    site = parse_station(options.station, log_format.origin_deg)
    search = _station_method(options.station_method, station_is_given=site is not None)
    forgetting_s = _forgetting_s(options)
    read = read_power_log(options.log, log_format)

    def find(measurements: Measurements) -> ChannelFit:
        return fit_channel_and_station(
            measurements,
            chosen,
            forgetting_s=forgetting_s,
            station_method=search,
            loss=loss,
        )

    def fit(measurements: Measurements) -> ChannelFit:
        if site is None:
            return find(measurements)
        return fit_channel(measurements, site, chosen, forgetting_s, loss=loss)

    def learn(measurements: Measurements) -> ChannelParameters:
        if site is None:
            return find(measurements).parameters
        return fitted_parameters(measurements, site, chosen, forgetting_s, loss=loss)

    try:
        found = fit(read.measurements)
    except InputError as error:
        raise at_file_line(error, options.log, log_format) from None
    warnings = (*log_warnings(read.measurements, log_format), *found.warnings)
    return LogFit(read.measurements, found, read.receivers, learn, log_format, warnings)


def _station_method(name: str | None, *, station_is_given: bool) -> StationMethod:
    """Return the method by which the station is found."""
    from typing import get_args

    from planopt.channel.estimation.station_fit import StationMethod

    names = get_args(StationMethod)
    if name is None:
        return "joint"
    _require(name in names, name, "--station-method", f"use {', '.join(names)}")
    if station_is_given:
        raise InputError(
            "the station is given, so there is nothing to find",
            key="--station-method",
            remedy="leave it out, or say --station unknown",
        )
    return cast("StationMethod", name)


def _log_format(options: LogOptions) -> LogFormat:
    """Return the format of the log."""
    from planopt.channel.power_log import (
        DEFAULT_COLUMNS,
        LogFormat,
        parse_columns,
        parse_origin,
        parse_rows,
    )

    resolution_db, position_std_m = options.resolution, options.position_error
    _require(0.0 <= resolution_db < math.inf, resolution_db, "--resolution", "give 0 or more")
    _require(0.0 <= position_std_m < math.inf, position_std_m, "--position-error", "give 0 or more")
    _require(math.isfinite(options.floor or 0.0), options.floor, "--floor", "give dBm")
    return LogFormat(
        DEFAULT_COLUMNS if options.columns is None else parse_columns(options.columns),
        options.censored,
        options.floor,
        options.time,
        options.receiver,
        resolution_db,
        position_std_m,
        parse_rows(options.where or ()),
        None if options.origin is None else parse_origin(options.origin),
    )


def _forgetting_s(options: LogOptions) -> float:
    """Return the forgetting time; infinite if none is given."""
    given = math.inf if options.forgetting is None else options.forgetting
    _require(given > 0.0, given, "--forgetting", "give more than 0 seconds")
    if options.forgetting is not None and options.time is None:
        raise InputError(
            "needs the times of the measurements",
            key="--forgetting",
            remedy="name the column of times with --time COLUMN",
        )
    return given


def _require(is_allowed: bool, value: object, key: str, remedy: str) -> None:
    """Refuse the value of an option."""
    if not is_allowed:
        raise InputError(f"{value!r} cannot be used", key=key, remedy=remedy)
