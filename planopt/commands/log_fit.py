"""Reading and channel fit of a power log, for ``planopt fit`` and ``planopt map``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast, get_args

from planopt.commands.options import FormatOptions, LogOptions
from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.channel.estimation.channel_fit import ChannelFit, Loss
    from planopt.channel.estimation.station_fit import StationMethod
    from planopt.channel.logs.log_format import LogFormat
    from planopt.channel.measurements import Measurements

DEGENERATE = 3
"""Exit code if the log does not determine the channel."""


@dataclass(frozen=True)
class LogFit:
    """A power log and the channel fitted to it."""

    measurements: Measurements
    found: ChannelFit
    receivers: tuple[str, ...]  # Receiver labels by number; empty without --receiver
    fit: Callable[[Measurements], ChannelFit]  # Fits other measurements with the same options
    log_format: LogFormat
    warnings: tuple[str, ...]  # From the fit, and about implausible values

    @property
    def exit_code(self) -> int:
        """Return 0, or `DEGENERATE` if the log does not determine the channel."""
        return DEGENERATE if self.found.status == "degenerate" else 0


def read_and_fit(options: LogOptions) -> LogFit:
    """Read a log and fit the channel."""
    from planopt.channel.estimation.channel_fit import require_loss, require_method
    from planopt.channel.estimation.fit import fit_channel
    from planopt.channel.estimation.station_fit import fit_channel_and_station
    from planopt.channel.logs.log_format import parse_station
    from planopt.channel.logs.power_log import at_file_line, read_power_log
    from planopt.problems.plausibility import log_warnings

    chosen = require_method(options.method, "--method")
    require_loss(options.loss, chosen, "--loss")
    loss = cast("Loss", options.loss)
    log_format = log_format_of(options)
    site = parse_station(options.station, log_format.origin_deg)
    search = _station_method(options.station_method, station_is_given=site is not None)
    forgetting_s = _forgetting_s(options)
    read = read_power_log(options.log, log_format)

    def fit(measurements: Measurements) -> ChannelFit:
        if site is not None:
            return fit_channel(measurements, site, chosen, forgetting_s, loss=loss)
        return fit_channel_and_station(
            measurements, chosen, forgetting_s=forgetting_s, station_method=search, loss=loss
        )

    try:
        found = fit(read.measurements)
    except InputError as error:
        raise at_file_line(error, options.log, log_format) from None
    warnings = (*log_warnings(read), *found.warnings)
    return LogFit(read.measurements, found, read.receivers, fit, log_format, warnings)


def _station_method(name: str | None, *, station_is_given: bool) -> StationMethod:
    """Return the method by which the station is located."""
    from planopt.channel.estimation.station_fit import StationMethod

    names = get_args(StationMethod)
    if name is None:
        return "joint"
    require_option(name in names, name, "--station-method", f"use {', '.join(names)}")
    if station_is_given:
        raise InputError(
            "the station is given, so there is nothing to find",
            key="--station-method",
            remedy="leave it out, or say --station unknown",
        )
    return cast("StationMethod", name)


OPTIONS = {
    "censored_column": "censored",
    "floor_dbm": "floor",
    "time_column": "time",
    "receiver_column": "receiver",
    "resolution_db": "resolution",
    "position_std_m": "position_error",
    "accuracy_column": "accuracy",
    "power_unit": "power_unit",
    "reader": "reader",
}
"""Option of each field of a log format that needs no parsing."""


def log_format_of(options: FormatOptions) -> LogFormat:
    """Return the format of the log that the options describe."""
    from planopt.channel.logs.log_format import LogFormat, parse_columns, parse_where
    from planopt.world.geodesy import parse_origin

    values = {field: getattr(options, name) for field, name in OPTIONS.items()}
    parsed: dict[str, Any] = {"where": parse_where(options.where or ())}
    if options.columns is not None:
        parsed["columns"] = parse_columns(options.columns)
    if options.origin is not None:
        parsed["origin_deg"] = parse_origin(options.origin)
    try:
        return LogFormat(**values, **parsed)
    except InputError as error:
        field = (error.key or "").rpartition(".")[2]
        key = f"--{OPTIONS.get(field, field).replace('_', '-')}"
        raise InputError(error.message, key=key, remedy=error.remedy) from None


def _forgetting_s(options: LogOptions) -> float:
    """Return the forgetting time; infinite by default."""
    value_s = math.inf if options.forgetting is None else options.forgetting
    require_option(value_s > 0.0, value_s, "--forgetting", "give more than 0 seconds")
    if options.forgetting is not None and options.time is None:
        raise InputError(
            "needs the times of the measurements",
            key="--forgetting",
            remedy="name the column of times with --time COLUMN",
        )
    return value_s


def require_option(is_allowed: bool, value: object, key: str, remedy: str) -> None:
    """Raise an error for an option's value unless it is allowed."""
    if not is_allowed:
        raise InputError(f"{value!r} cannot be used", key=key, remedy=remedy)
