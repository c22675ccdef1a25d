"""A base station of a problem: where it stands, its radio, its true channel and measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import Field

from planopt.channel.parameters import Station
from planopt.problems.channel_setup import LoggedMeasurements, RasterTruth
from planopt.problems.tables import Decibels, FilePath, Metres, Name, Pair, Part


def raster_truth_of(truth: RasterTruth, radio: BaseStation) -> RasterTruth:
    """The map of a station: the truth's, but for what the station has of its own."""
    return replace(
        truth,
        file=radio.gain_file or truth.file,
        variable=radio.gain_variable or truth.variable,
    )


def log_of(log: LoggedMeasurements, radio: BaseStation) -> LoggedMeasurements:
    """The log of a station: that of all stations, but for what it has of its own.

    Rows that a common log marks as censored are so for another station's power.
    """
    x, y, power = log.columns
    shared = radio.log_file is None and radio.power_column is not None
    return replace(
        log,
        file=radio.log_file or log.file,
        columns=(x, y, radio.power_column or power),
        censored_column=radio.censored_column or (None if shared else log.censored_column),
    )


@dataclass(frozen=True, kw_only=True)
class BaseStation(Part):
    """A fixed station: a base station, access point or gateway.

    Examples
    --------
    >>> from planopt import BaseStation
    >>> mast = BaseStation(position_m=(40, 0), transmit_power_dbm=30.0, threshold_dbm=-83.0)
    >>> mast.name, mast.height_m
    ('station', 0.0)
    """

    at = "stations[]"

    position_m: Pair
    """Place [x, y] in metres; it may be outside the bounds."""
    height_m: Metres = 0.0
    """Height of its antenna above the robots' antennas, in metres."""
    transmit_power_dbm: Decibels
    """Transmit power in dBm; received power is this plus the path gain."""
    threshold_dbm: Decibels
    """Received power in dBm from which on a robot is connected, as plans and proofs take it."""
    receive_threshold_dbm: Decibels | None = None
    """Received power in dBm from which on a robot truly is connected in a simulation, where that is
    not threshold_dbm."""
    name: Name = "station"
    """What outputs call it."""
    gain_file: FilePath | None = None
    """Map of its path gains, where channel.truth is a raster: in place of channel.truth.file. Each
    station needs a map of its own."""
    gain_variable: Annotated[str | None, Field(min_length=1)] = None
    """Name of its path gain in dB, in place of channel.truth.variable."""
    log_file: FilePath | None = None
    """CSV log of its first measurements, in place of channel.measurements.file. Each station needs
    a log or a power_column of its own."""
    power_column: Annotated[str | None, Field(min_length=1)] = None
    """Column of its power in dBm in the log, in place of channel.measurements.columns.power."""
    censored_column: Annotated[str | None, Field(min_length=1)] = None
    """Column that marks its censored rows; of a log of its own, by default that of
    channel.measurements."""

    @property
    def true_threshold_dbm(self) -> float:
        """Received power from which on a robot truly is connected."""
        least = self.receive_threshold_dbm
        return self.threshold_dbm if least is None else least

    @property
    def site(self) -> Station:
        """Return the place of its antenna, for the channel model."""
        return Station(self.position_m, self.height_m)
