"""Where the true channel and the first measurements of one station come from."""

from __future__ import annotations

from dataclasses import replace

from planopt.problems.base_station import BaseStation
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
