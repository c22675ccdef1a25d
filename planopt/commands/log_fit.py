"""Reading and channel fit of a power log, for ``planopt fit`` and ``planopt map``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast, get_args

from planopt.commands.options import LogOptions
from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.channel.estimation.channel_fit import ChannelFit, Loss
    from planopt.channel.estimation.station_fit import StationMethod
    from planopt.channel.measurements import Measurements
    from planopt.channel.power_log import LogFormat

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
    warnings = (*log_warnings(read.measurements, log_format), *found.warnings)
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
    require_option(0.0 <= resolution_db < math.inf, resolution_db, "--resolution", "give 0 or more")
    require_option(
        0.0 <= position_std_m < math.inf, position_std_m, "--position-error", "give 0 or more"
    )
    require_option(math.isfinite(options.floor or 0.0), options.floor, "--floor", "give dBm")
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
