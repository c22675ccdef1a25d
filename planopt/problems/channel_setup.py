"""The sources of a problem's true channel and of its first measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from planopt.channel.estimation.channel_fit import FitMethod
from planopt.channel.fields.multipath import Multipath
from planopt.errors import InputError
from planopt.parts import part_of
from planopt.plain_values import make_plain
from planopt.problems.tables import Decibels
from planopt.short_repr import short_repr


@dataclass(frozen=True, kw_only=True)
class RasterTruth:
    """The true channel as a raster of path gains, with seeded small-scale fading on top.

    Attributes
    ----------
    file
        A map that :func:`planopt.world.raster_files.read_raster` reads.
    variable
        Name of the path gain in dB, or of the received power in dBm; NaN where nothing arrives.
    quantity
        ``gain`` or ``power``: the station's transmit power is added to gains.
    floor_db
        The receiver's floor as a path gain: smaller gains are clipped to it and censored.
    multipath
        The law of the fading, or None for none.
    """

    file: Path
    variable: str = "path_gain_db"
    quantity: Literal["gain", "power"] = "gain"
    floor_db: float
    multipath: Multipath | None = None

    def __post_init__(self) -> None:
        make_plain(self, "file")


@dataclass(frozen=True, kw_only=True)
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
    floor_db: float | None = None
    multipath: Multipath | None = None


@dataclass(frozen=True, kw_only=True)
class FittedTruth:
    """The true channel drawn from its posterior, given the log of the first measurements.

    Parameters are estimated from the log by ``channel.fit``; path loss, shadowing and multipath are
    drawn with the seed.

    Attributes
    ----------
    cell_m
        Cell side of the drawn raster.
    floor_db
        As in :class:`RasterTruth`, or None for no floor.
    """

    cell_m: float
    floor_db: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrayTruth:
    """The true channel as arrays of received power. Saved results leave it out.

    Attributes
    ----------
    x_m, y_m
        ``(nx,)`` and ``(ny,)`` cell centres, ascending and evenly spaced.
    power_dbm
        ``(ny, nx)`` received power, or ``(stations, ny, nx)`` of several stations; NaN where
        nothing arrives, for which a floor is needed.
    floor_dbm
        The receiver's floor: smaller powers are clipped to it and censored; None for none.

    Examples
    --------
    >>> import numpy as np
    >>> from planopt.problems import ArrayTruth
    >>> x, y = np.arange(0.5, 100.0), np.arange(0.5, 60.0)
    >>> truth = ArrayTruth(x_m=x, y_m=y, power_dbm=-40.0 - 0.3 * np.hypot(x, y[:, None]))
    """

    x_m: ArrayLike
    y_m: ArrayLike
    power_dbm: ArrayLike
    floor_dbm: float | None = None

    __repr__ = short_repr


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionTruth:
    """The true channel as a function of the place. Saved results leave it out.

    The function is evaluated once, at the centres of the cells that cover the workspace; a robot
    receives the power of the cell that it is in.

    Attributes
    ----------
    power_dbm
        From places ``(n, 2)`` in metres to received power ``(n,)``, or ``(stations, n)`` of several
        stations; NaN where nothing arrives, for which a floor is needed.
    cell_m
        Cell side.
    floor_dbm
        As in :class:`ArrayTruth`.

    Examples
    --------
    >>> import numpy as np
    >>> from planopt.problems import FunctionTruth
    >>> truth = FunctionTruth(power_dbm=lambda places_m: -50.0 - 0.2 * places_m[:, 0], cell_m=0.5)
    """

    power_dbm: Callable[[NDArray[np.float64]], ArrayLike]
    cell_m: float = 1.0
    floor_dbm: float | None = None

    def __post_init__(self) -> None:
        if not callable(self.power_dbm):
            raise InputError(
                f"is a {type(self.power_dbm).__name__}, nothing that can be called",
                key="channel.truth.power_dbm",
                remedy="give a function of places (n, 2) in metres, or an ArrayTruth for arrays",
            )


ChannelTruth = RasterTruth | ModelTruth | FittedTruth | ArrayTruth | FunctionTruth
"""Where the true channel comes from."""


@dataclass(frozen=True)
class SampledMeasurements:
    """First measurements taken from the truth at `count` seeded random free places.

    With a `count` of 0 none are taken: they are given to :func:`planopt.solve`,
    :func:`planopt.simulate` or :class:`planopt.Planner`.
    """

    count: int = 0

    def __post_init__(self) -> None:
        make_plain(self)
        count = cast("object", self.count)
        if not isinstance(count, int) or isinstance(count, bool) or count < 0:
            raise InputError(
                f"is {count!r}, should be a whole number, at least 0",
                key="channel.measurements.count",
                remedy="give how many places are measured at first, such as 100",
            )


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
    columns: tuple[str, str, str] = ("x_m", "y_m", "power_dbm")
    censored_column: str | None = None
    floor_dbm: float | None = None

    def __post_init__(self) -> None:
        make_plain(self, "file")


@dataclass(frozen=True, kw_only=True)
class GivenParameters:
    """Parameters of the channel that are known, so that they are not estimated.

    Attributes
    ----------
    shadow_std_db, decorrelation_m, multipath_std_db
        As in :class:`planopt.channel.parameters.ChannelParameters`.
    k_pl_db, n_pl
        Path loss; ``k_pl_db`` is a gain, to which a station's transmit power is added. Both None:
        path loss is estimated from the measurements, with its uncertainty.
    """

    shadow_std_db: Annotated[
        float, Field(ge=0, le=100, description="xi, deviation of shadowing in dB.")
    ]
    decorrelation_m: Annotated[
        float,
        Field(gt=0, le=1e6, description="beta, decorrelation distance of shadowing in metres."),
    ]
    multipath_std_db: Annotated[
        float, Field(ge=0, le=100, description="omega, deviation of multipath in dB.")
    ]
    k_pl_db: Annotated[
        Decibels | None,
        Field(
            description="K_PL as a path gain at one metre in dB; left out, with n_pl: path loss is "
            "estimated."
        ),
    ] = None
    n_pl: Annotated[
        float | None, Field(gt=0, le=20, description="n_PL, path loss exponent (a number).")
    ] = None

    def __post_init__(self) -> None:
        if (self.k_pl_db is None) != (self.n_pl is None):
            raise InputError(
                "has one of k_pl_db and n_pl",
                key="channel.fit.given",
                remedy="give both, or none to have path loss estimated",
            )


@dataclass(frozen=True, kw_only=True)
class ChannelSetup:
    """Sources of ground truth and first measurements, and the fit of the channel.

    Attributes
    ----------
    truth
        What `simulate` drives in; None if there is none.
    measurements
        The first measurements.
    fit_method
        How parameters are estimated from them.
    given
        Parameters that are known; None where all are estimated.
    measure_spacing_m
        On the way a robot measures again only at this distance from every earlier measurement:
        fading at one place keeps its value, so measuring it twice teaches nothing.
    share_measurements
        Whether every robot has the measurements of all after each step.
    """

    truth: ChannelTruth | None = None
    measurements: SampledMeasurements | LoggedMeasurements = field(
        default_factory=SampledMeasurements
    )
    fit_method: FitMethod = "reml"
    given: GivenParameters | None = None
    measure_spacing_m: float = 2.0
    share_measurements: bool = False

    def __post_init__(self) -> None:
        make_plain(self)
        if self.truth is not None:
            remedy = (
                "give one ArrayTruth, FunctionTruth, RasterTruth, ModelTruth or FittedTruth; one "
                "has the powers of all stations, (stations, ...)"
            )
            part_of("channel.truth", self.truth, cast("type[object]", ChannelTruth), remedy)
        part_of(
            "channel.measurements",
            self.measurements,
            cast("type[object]", SampledMeasurements | LoggedMeasurements),
            "give SampledMeasurements or LoggedMeasurements; tables go to solve(measurements=)",
        )
