"""A base station of a problem: where it stands, its radio, its true channel and measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from planopt.channel.parameters import Station
from planopt.plain_values import make_plain
from planopt.problems.channel_setup import LoggedMeasurements, RasterTruth


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
class BaseStation:
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

    position_m: tuple[float, float]
    height_m: float = 0.0
    transmit_power_dbm: float
    threshold_dbm: float
    receive_threshold_dbm: float | None = None
    name: str = "station"
    gain_file: Path | None = None
    gain_variable: str | None = None
    log_file: Path | None = None
    power_column: str | None = None
    censored_column: str | None = None

    def __post_init__(self) -> None:
        make_plain(self, "gain_file", "log_file")

    @property
    def true_threshold_dbm(self) -> float:
        """Received power from which on a robot truly is connected."""
        least = self.receive_threshold_dbm
        return self.threshold_dbm if least is None else least

    @property
    def site(self) -> Station:
        """Return the place of its antenna, for the channel model."""
        return Station(self.position_m, self.height_m)
