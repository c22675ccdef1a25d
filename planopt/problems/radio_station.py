"""A fixed station with its radio."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planopt.channel.parameters import Station


@dataclass(frozen=True)
class RadioStation:
    """A fixed station with its radio.

    Attributes
    ----------
    name
        What outputs call it.
    site
        Where it stands and how high.
    transmit_power_dbm
        Added to a truth map's path gain.
    threshold_dbm
        Upsilon_TH: received power from which on a robot is connected.
    gain_file, gain_variable
        Its own map of path gains in place of a raster truth's, and the gain's name there; None for
        the truth's.
    log_file, power_column, censored_column
        Its own log of first measurements in place of that of all stations, the power's column, and
        the one that marks censored rows; None for that log's.
    """

    name: str
    site: Station
    transmit_power_dbm: float
    threshold_dbm: float
    gain_file: Path | None = None
    gain_variable: str | None = None
    log_file: Path | None = None
    power_column: str | None = None
    censored_column: str | None = None
