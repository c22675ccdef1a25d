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

    Attributes
    ----------
    position_m
        Place ``(x, y)`` in metres; it may be outside the workspace.
    height_m
        Height of its antenna above the robots' antennas.
    transmit_power_dbm
        Added to path gains.
    threshold_dbm
        Received power from which on a robot is connected, as plans and proofs take it.
    receive_threshold_dbm
        Received power from which on a robot truly is, in a simulation; None for the same.
    name
        Name in outputs.
    gain_file, gain_variable
        Its own map of path gains in place of a :class:`RasterTruth`'s, and the gain's name there.
    log_file, power_column, censored_column
        Its own log of first measurements in place of a :class:`LoggedMeasurements`'s, the column of
        its power, and the one that marks censored rows.

    Examples
    --------
    >>> from planopt import BaseStation
    >>> mast = BaseStation(position_m=(40, 0), transmit_power_dbm=30.0, threshold_dbm=-83.0)
    >>> mast.name, mast.height_m
    ('station', 0.0)
    """

    at = "stations[]"

    position_m: Annotated[
        Pair, Field(description="Place [x, y] in metres; it may be outside the bounds.")
    ]
    height_m: Annotated[
        Metres,
        Field(description="Height of its antenna above the robots' antennas, in metres."),
    ] = 0.0
    transmit_power_dbm: Annotated[
        Decibels,
        Field(description="Transmit power in dBm; received power is this plus the path gain."),
    ]
    threshold_dbm: Annotated[
        Decibels,
        Field(
            description="Received power in dBm from which on a robot is connected, as plans and "
            "proofs take it."
        ),
    ]
    receive_threshold_dbm: Annotated[
        Decibels | None,
        Field(
            description="Received power in dBm from which on a robot truly is connected in a "
            "simulation, where that is not threshold_dbm."
        ),
    ] = None
    name: Annotated[Name, Field(description="What outputs call it.")] = "station"
    gain_file: Annotated[
        FilePath | None,
        Field(
            description="Map of its path gains, where channel.truth is a raster: in place of "
            "channel.truth.file. Each station needs a map of its own."
        ),
    ] = None
    gain_variable: Annotated[
        str | None,
        Field(
            min_length=1,
            description="Name of its path gain in dB, in place of channel.truth.variable.",
        ),
    ] = None
    log_file: Annotated[
        FilePath | None,
        Field(
            description="CSV log of its first measurements, in place of channel.measurements.file. "
            "Each station needs a log or a power_column of its own."
        ),
    ] = None
    power_column: Annotated[
        str | None,
        Field(
            min_length=1,
            description="Column of its power in dBm in the log, in place of "
            "channel.measurements.columns.power.",
        ),
    ] = None
    censored_column: Annotated[
        str | None,
        Field(
            min_length=1,
            description="Column that marks its censored rows; of a log of its own, by default "
            "that of channel.measurements.",
        ),
    ] = None

    @property
    def true_threshold_dbm(self) -> float:
        """Received power from which on a robot truly is connected."""
        least = self.receive_threshold_dbm
        return self.threshold_dbm if least is None else least

    @property
    def site(self) -> Station:
        """Return the place of its antenna, for the channel model."""
        return Station(self.position_m, self.height_m)
