"""A fixed station with its radio."""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    name: str
    site: Station
    transmit_power_dbm: float
    threshold_dbm: float
