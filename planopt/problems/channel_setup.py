"""Where the true channel and the first measurements of a problem come from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from planopt.channel.estimation.channel_fit import FitMethod
from planopt.channel.multipath.multipath_models import Multipath

CalibrationName = Literal["none", "platt"]
"""How predicted probabilities of connection are calibrated."""


@dataclass(frozen=True)
class RasterTruth:
    """The true channel as a raster of path gains, with seeded small-scale fading on top.

    Attributes
    ----------
    file
        A map that :func:`planopt.world.raster_files.read_raster` reads.
    variable
        Name of the path gain in dB; NaN where nothing arrives.
    floor_db
        The receiver's floor as a path gain: smaller gains are clipped to it and censored.
    multipath
        The law of the fading, or None for none.
    """

    file: Path
    variable: str
    floor_db: float
    multipath: Multipath | None


@dataclass(frozen=True)
class ModelTruth:
    """The true channel drawn from the channel model itself, for synthetic problems.

    Attributes
    ----------
    k_pl_db, n_pl, shadow_std_db, decorrelation_m, multipath_std_db
        As in :class:`planopt.channel.parameters.ChannelParameters`; ``k_pl_db`` is a gain, to
        which the station's transmit power is added.
    cell_m
        Cell side of the drawn raster.
    floor_db
        As in :class:`RasterTruth`, or None for no floor.
    multipath
        Its law, of deviation ``multipath_std_db``; None for Gaussian in dB.
    """

    k_pl_db: float
    n_pl: float
    shadow_std_db: float
    decorrelation_m: float
    multipath_std_db: float
    cell_m: float
    floor_db: float | None
    multipath: Multipath | None = None


@dataclass(frozen=True)
class SampledMeasurements:
    """First measurements taken from the truth at `count` seeded random free places."""

    count: int


@dataclass(frozen=True)
class LoggedMeasurements:
    """First measurements read from a CSV log.

    Attributes
    ----------
    file
        The log.
    columns
        Column names of x, y and power.
    censored_column
        Column that marks censored rows, or None.
    floor_dbm
        Powers at or below this are censored, or None.
    """

    file: Path
    columns: tuple[str, str, str]
    censored_column: str | None
    floor_dbm: float | None


@dataclass(frozen=True)
class ChannelSetup:
    """Where the truth and the first measurements come from and how the channel is fitted.

    Attributes
    ----------
    truth
        What `simulate` drives in; None if there is none.
    measurements
        The first measurements.
    fit_method
        How parameters are estimated from them.
    measure_spacing_m
        On the way a robot measures again only at this distance from every earlier measurement:
        fading at one place keeps its value, so measuring it twice teaches nothing.
    calibration
        How predicted probabilities of connection are calibrated on what was measured.
    """

    truth: RasterTruth | ModelTruth | None
    measurements: SampledMeasurements | LoggedMeasurements
    fit_method: FitMethod
    measure_spacing_m: float
    calibration: CalibrationName = "none"
