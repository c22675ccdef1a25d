"""Radio setup of a problem: base stations, ground truth, initial measurements and channel fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from numpy.typing import ArrayLike
from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator, model_validator

from planopt.arrays import Floats
from planopt.channel.estimation.channel_fit import FitMethod
from planopt.channel.ground_truth import (
    Lognormal,
    Multipath,
    MultipathKind,
    Nakagami,
    Rician,
    multipath_of,
)
from planopt.channel.logs.log_format import DEFAULT_FORMAT, LogFormat
from planopt.channel.parameters import Station
from planopt.errors import InputError
from planopt.keys import (
    Decibels,
    FilePath,
    Metres,
    Name,
    OriginKey,
    Pair,
    Part,
    ReadAs,
    Table,
    fault_of,
    table_of,
)
from planopt.parts import make_plain, part_of
from planopt.short_repr import short_repr
from planopt.world.geodesy import Origin

MIN_DEVIATION_DB = 0.001
"""Standard deviation in dB below which fading counts as absent; m and K would be too large."""


class MultipathTable(Table):
    """Table ``multipath``: a kind, and exactly one of m, k and std_db (none for rayleigh)."""

    kind: MultipathKind
    """Fading distribution: nakagami, rician, rayleigh or lognormal."""
    m: float | None = Field(default=None, ge=0.5, le=1e8)
    """Nakagami parameter m (a number, at least 1 for rician)."""
    k: float | None = Field(default=None, ge=0, le=1e8)
    """Rician K factor (linear ratio)."""
    std_db: float | None = Field(default=None, ge=0, le=100)
    """Standard deviation omega of multipath in dB."""

    @property
    def law(self) -> Multipath:
        """Return the fading distribution."""
        return multipath_of(self.kind, m=self.m, k=self.k, std_db=self.std_db)

    @model_validator(mode="after")
    def _exists(self) -> MultipathTable:
        try:
            deviation = self.law.std_db
        except InputError as error:
            words = error.message if error.remedy is None else f"{error.message}: {error.remedy}"
            raise fault_of(words) from error
        # Above this limit a saved law can be expressed by its own parameter.
        if deviation < MIN_DEVIATION_DB and self.kind != "lognormal":
            raise fault_of(
                f"has a standard deviation below {MIN_DEVIATION_DB} dB: leave multipath out, "
                "or increase it"
            )
        return self


def _law_keys(law: Any) -> Any:
    """Return the table of a fading law; other values are returned unchanged for validation."""
    match law:
        case Rician():
            return {"kind": "rician", "k": law.k_factor}
        case Nakagami():
            return {"kind": "nakagami", "m": law.m}
        case Lognormal():
            return {"kind": "lognormal", "std_db": law.std_db}
        case _:
            return law


COUNT_WORDS = (
    "Number of initial measurements, drawn from the ground truth at random free positions; 0 only "
    "if fit.given contains the path loss, or if the initial measurements come from Python."
)
Shadowing = Annotated[float, Field(ge=0, le=100, description="xi, deviation of shadowing in dB.")]
Decorrelation = Annotated[
    float, Field(gt=0, le=1e6, description="beta, decorrelation distance of shadowing in metres.")
]
Fading = Annotated[Multipath, ReadAs(MultipathTable, attrgetter("law"))]
Cell = Annotated[float, Field(gt=0, le=1e6, description="Cell side of the drawn map in metres.")]
Floor = Annotated[
    Decibels | None,
    Field(description="The receiver's floor as a path gain in dB; left out: no floor."),
]


class RicianKeys(Table):
    """Key for the Rician fading of a raster map."""

    rician_k: float | None = Field(default=None, gt=0, le=1e8)
    """Rician K factor (linear ratio) of small-scale fading; default: no fading."""


class LawKeys(Table):
    """Keys for the multipath of a simulated channel: a standard deviation or a distribution."""

    multipath_std_db: float | None = Field(default=None, ge=0, le=100)
    """Standard deviation omega in dB of multipath that is Gaussian in dB."""
    multipath: Fading | None = None
    """Multipath with another distribution, in place of multipath_std_db."""

    @model_validator(mode="after")
    def _one_multipath(self) -> LawKeys:
        if (self.multipath_std_db is None) == (self.multipath is None):
            given = "none" if self.multipath is None else "both"
            raise fault_of(
                f"needs exactly one of multipath_std_db and multipath, but has {given}: write "
                "for instance multipath_std_db = 3.0"
            )
        return self


@dataclass(frozen=True, kw_only=True)
class RasterTruth(Part):
    """Ground truth: raster of path gains plus random small-scale fading."""

    at = "channel.truth"
    kind = "raster"
    Keys = RicianKeys

    file: FilePath
    """Map file relative to the problem file: npz (x, y and the variable on [iy, ix], or a radio map
    of Sionna RT), CSV, NetCDF or GeoTIFF, by ending."""
    variable: Annotated[str, Field(min_length=1)] = "path_gain_db"
    """Name of the path gain variable in dB."""
    quantity: Literal["gain", "power"] = "gain"
    """Quantity: gain (path gain in dB, to which transmit_power_dbm is added) or power (received
    power in dBm, such as mean_db of planopt map)."""
    floor_db: Decibels
    """Receiver floor as a path gain in dB; smaller gains are clipped and censored."""
    origin_deg: OriginKey = None
    """Latitude and longitude in degrees of (0, 0), and the angle from east to the x axis if it is
    not 0: a GeoTIFF in any reference system becomes metres."""
    multipath: Fading | None = None
    """Small-scale fading with another distribution, in place of rician_k."""

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of the table, with Rician fading as rician_k."""
        keys, law = super().to_keys(), self.multipath
        if isinstance(law, Rician) and law.k_factor > 0.0:
            return {**keys, "multipath": None, "rician_k": law.k_factor}
        return {**keys, "multipath": _law_keys(law)}

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the fields, with the fading law from rician_k or multipath."""
        if table.rician_k is None:
            return super().of_keys(table)
        if table.multipath is not None:
            raise fault_of("has both rician_k and multipath: leave rician_k out")
        return {**super().of_keys(table), "multipath": Rician(table.rician_k)}


@dataclass(frozen=True, kw_only=True)
class ModelTruth(Part):
    """Ground truth: realisation of the channel model, for synthetic problems."""

    at = "channel.truth"
    kind = "model"
    Keys = LawKeys
    not_keys = frozenset({"multipath_std_db", "multipath"})

    k_pl_db: Decibels
    """Path gain K_PL at one metre in dB."""
    n_pl: Annotated[float, Field(gt=0, le=20)]
    """Path loss exponent n_PL (a number)."""
    shadow_std_db: Shadowing
    decorrelation_m: Decorrelation
    multipath_std_db: float
    """Standard deviation omega of multipath in dB; that of `multipath` if it is not None."""
    cell_m: Cell
    floor_db: Floor = None
    multipath: Multipath | None = None
    """Fading distribution; None for Gaussian in dB."""

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of the table, with a distribution or the standard deviation."""
        keys = super().to_keys()
        if self.multipath is None:
            return {**keys, "multipath_std_db": self.multipath_std_db}
        return {**keys, "multipath": _law_keys(self.multipath)}

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the fields; the standard deviation of a distribution is computed."""
        law = table.multipath
        deviation = table.multipath_std_db if law is None else law.std_db
        return {**super().of_keys(table), "multipath": law, "multipath_std_db": deviation}


@dataclass(frozen=True, kw_only=True)
class FittedTruth(Part):
    """Ground truth: realisation of the channel posterior conditional on the measurement log.

    The parameters are estimated from the log by ``channel.fit``. Path loss, shadowing and multipath
    are drawn with the seed.
    """

    at = "channel.truth"
    kind = "fitted"

    cell_m: Cell
    floor_db: Floor = None


LogKeys: Any = table_of(LogFormat)
"""Table model with the keys of a power log's format."""

LOG_KEYS = tuple(LogKeys.model_fields)


@dataclass(frozen=True, kw_only=True)
class MeasuredTruth(Part):
    """Ground truth: the nearest reading of a log within a distance.

    The table has the keys of a log's format, as ``channel.measurements`` has. A robot measures
    nothing at positions without a reading, and metrics of connection leave their steps out.
    """

    at = "channel.truth"
    kind = "measured"
    Keys = LogKeys
    not_keys = frozenset({"log_format"})

    file: FilePath
    """Log of the readings, relative to the problem file; `$PLANOPT_DATA/...` names a file in the
    folder of that environment variable."""
    transmitter_column: Annotated[str, Field(min_length=1)] | None = None
    """Column of the log that names the transmitter, as in channel.measurements."""
    within_m: Annotated[float, Field(gt=0, le=1e6)] = 0.5
    """Distance in metres up to which a reading stands for the power at a position."""
    cell_m: Cell
    log_format: LogFormat = DEFAULT_FORMAT
    """Columns, units and row filter."""

    @property
    def log(self) -> LoggedMeasurements:
        """Return the source of the readings."""
        return LoggedMeasurements(self.file, self.log_format, self.transmitter_column)

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of the table and of the log's format."""
        return {**super().to_keys(), **self.log_format.to_keys()}

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the fields, with the log's format."""
        return {**super().of_keys(table), "log_format": LogFormat.of_table(table)}


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrayTruth:
    """Ground truth: arrays of received power. Saved results do not contain them.

    Attributes
    ----------
    x_m, y_m
        Cell centres ``(nx,)`` and ``(ny,)``, ascending and evenly spaced.
    power_dbm
        Received power ``(ny, nx)``, or ``(stations, ny, nx)`` for several stations; NaN for no
        reception, which requires a floor.
    floor_dbm
        Receiver floor, below which powers are clipped and censored; None for no floor.

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
    """Ground truth: received power as a function of position. Saved results do not contain it.

    The function is evaluated once at the centres of the cells that cover the workspace. A robot
    receives the power of its cell.

    Attributes
    ----------
    power_dbm
        Function of positions ``(n, 2)`` in metres that returns received power ``(n,)``, for several
        stations ``(stations, n)``; NaN for no reception, which requires a floor.
    cell_m
        Side of the cells in metres.
    floor_dbm
        Receiver floor as in :class:`ArrayTruth`.

    Examples
    --------
    >>> import numpy as np
    >>> from planopt.problems import FunctionTruth
    >>> truth = FunctionTruth(power_dbm=lambda places_m: -50.0 - 0.2 * places_m[:, 0], cell_m=0.5)
    """

    power_dbm: Callable[[Floats], ArrayLike]
    cell_m: float = 1.0
    floor_dbm: float | None = None

    def __post_init__(self) -> None:
        if not callable(self.power_dbm):
            raise InputError(
                f"is of type {type(self.power_dbm).__name__}, should be a function",
                key="channel.truth.power_dbm",
                remedy="give a function of positions (n, 2) in metres, or use ArrayTruth for "
                "arrays",
            )


ChannelTruth = RasterTruth | ModelTruth | FittedTruth | MeasuredTruth | ArrayTruth | FunctionTruth
"""Source of the ground truth."""


@dataclass(frozen=True)
class SampledMeasurements(Part):
    """Initial measurements sampled from the ground truth at `count` random free positions.

    If `count` is 0, measurements must be passed to :func:`planopt.solve`,
    :func:`planopt.simulate` or :class:`planopt.Planner`.
    """

    at = "channel.measurements"

    count: Annotated[int, Field(ge=0, le=100_000, description=COUNT_WORDS)] = 0


@dataclass(frozen=True)
class LoggedMeasurements:
    """Initial measurements read from a log.

    Attributes
    ----------
    file
        Path of the log.
    log_format
        Columns, units and row filter.
    transmitter_column
        Column with the transmitter's name, by which each station selects its rows.
    """

    file: Path
    log_format: LogFormat = DEFAULT_FORMAT
    transmitter_column: str | None = None

    def __post_init__(self) -> None:
        make_plain(self, "file")


@dataclass(frozen=True, kw_only=True)
class GivenParameters(Part):
    """Known channel parameters, which are not estimated."""

    at = "channel.fit.given"

    shadow_std_db: Shadowing
    decorrelation_m: Decorrelation
    multipath_std_db: Annotated[float, Field(ge=0, le=100)]
    """Standard deviation omega of multipath in dB."""
    k_pl_db: Decibels | None = None
    """Path gain K_PL at one metre in dB; default, with n_pl: path loss is estimated."""
    n_pl: Annotated[float | None, Field(gt=0, le=20)] = None
    """Path loss exponent n_PL (a number)."""

    def fault(self) -> str | None:
        """Return a message if only one of k_pl_db and n_pl is set."""
        if (self.k_pl_db is None) == (self.n_pl is None):
            return None
        return "has one of k_pl_db and n_pl: give both, or none to have path loss estimated"


class MeasurementsTable(LogKeys):
    """Table ``[channel.measurements]``: exactly one of ``count`` and ``file``."""

    count: int | None = Field(default=None, ge=0, le=100_000, description=COUNT_WORDS)
    file: FilePath | None = None
    """Log of initial measurements, relative to the problem file: CSV or a known program's log."""
    transmitter_column: str | None = Field(default=None, min_length=1)
    """Column of the log that names the transmitter. Each station uses the rows that name it, by
    stations.transmitter or else its name."""
    spacing_m: float = Field(default=2.0, ge=0, le=1e6)
    """Minimum distance in metres of a moving robot's new measurement from all earlier ones."""
    shared: bool = False
    """True if robots share all measurements after each step."""

    @model_validator(mode="after")
    def _one_source(self) -> MeasurementsTable:
        if (self.count is None) == (self.file is None):
            given = "none" if self.count is None else "count and file"
            raise fault_of(
                f"needs exactly one of count and file, but has {given}: write count = 100, or "
                'file = "log.csv"'
            )
        for key in ("transmitter_column", *LOG_KEYS):
            if self.file is None and key in self.model_fields_set:
                raise fault_of(
                    f"has {key}, which applies only to a log file: leave it out, or add file"
                )
        return self

    @property
    def source(self) -> SampledMeasurements | LoggedMeasurements:
        """Return the source of initial measurements that the table describes."""
        if self.file is None:
            return SampledMeasurements(self.count or 0)
        return LoggedMeasurements(self.file, LogFormat.of_table(self), self.transmitter_column)


class FitTable(Table):
    """Table ``[channel.fit]``: estimation of the channel parameters."""

    method: FitMethod = "reml"
    """Estimation method: reml, map, lemma1, capped, convex or nls (see docs/channel.md, Fit)."""
    given: GivenParameters | None = None
    """Known parameters, which are not estimated: shadow_std_db, decorrelation_m and
    multipath_std_db, and optionally both k_pl_db and n_pl."""


def _read_truth(value: object, handler: ValidatorFunctionWrapHandler) -> Any:
    """Accept a ground truth object unchanged; otherwise read its table."""
    return value if isinstance(value, ArrayTruth | FunctionTruth) else handler(value)


AnyTruth = Annotated[
    RasterTruth | ModelTruth | FittedTruth | MeasuredTruth,
    Field(discriminator="kind"),
    WrapValidator(_read_truth),
]


class ChannelKeys(Table):
    """Table ``[channel]``: ground truth, initial measurements and fit."""

    truth: AnyTruth | None = None
    """Ground truth for simulations (optional)."""
    measurements: MeasurementsTable
    fit: FitTable = FitTable()


@dataclass(frozen=True, kw_only=True)
class ChannelSetup(Part):
    """Channel setup: ground truth, initial measurements and parameter estimation."""

    at = "channel"
    Keys = ChannelKeys

    truth: ChannelTruth | None = None
    """Ground truth of simulations; None for a problem without simulations."""
    measurements: SampledMeasurements | LoggedMeasurements = field(
        default_factory=SampledMeasurements
    )
    """Source of the initial measurements."""
    fit_method: FitMethod = "reml"
    """Method of parameter estimation."""
    given: GivenParameters | None = None
    """Known parameters; None if all are estimated."""
    measure_spacing_m: float = 2.0
    """Minimum distance in metres between a new measurement and all earlier ones: fading is constant
    in time, so a repeated measurement gives no information."""
    share_measurements: bool = False
    """True if robots share all measurements after each step."""

    not_keys = frozenset(__annotations__)

    @property
    def origin_deg(self) -> Origin | None:
        """Return the origin of the frame from a log or map of the channel; None without one."""
        log, truth = self.measurements, self.truth
        if isinstance(log, LoggedMeasurements) and log.log_format.origin_deg is not None:
            return log.log_format.origin_deg
        return truth.origin_deg if isinstance(truth, RasterTruth) else None

    def __post_init__(self) -> None:
        if self.truth is not None:
            remedy = (
                "give one ArrayTruth, FunctionTruth, RasterTruth, ModelTruth, FittedTruth or "
                "MeasuredTruth; a single one has the powers (stations, ...) of all stations"
            )
            part_of("channel.truth", self.truth, cast("type[object]", ChannelTruth), remedy)
        part_of(
            "channel.measurements",
            self.measurements,
            cast("type[object]", SampledMeasurements | LoggedMeasurements),
            "give SampledMeasurements or LoggedMeasurements; tables go to solve(measurements=)",
        )
        super().__post_init__()

    def fault(self) -> str | None:
        """Return a message if the map and the log have different origins in degrees; else None."""
        other = self.truth.origin_deg if isinstance(self.truth, RasterTruth) else None
        if other in (None, self.origin_deg):
            return None
        return (
            f"has a map with origin_deg {list(other)} and a log with origin_deg "
            f"{list(self.origin_deg or ())}: give both the same origin"
        )

    def to_keys(self) -> dict[str, Any]:
        """Return the table with its subtables."""
        source = self.measurements
        measurements: dict[str, Any] = {
            "spacing_m": self.measure_spacing_m,
            "shared": self.share_measurements,
        }
        if isinstance(source, LoggedMeasurements):
            measurements["file"] = source.file
            measurements["transmitter_column"] = source.transmitter_column
            measurements |= source.log_format.to_keys()
        else:
            measurements["count"] = source.count
        fit = {"method": self.fit_method, "given": self.given}
        return {"truth": self.truth, "measurements": measurements, "fit": fit}

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the fields from the table and its subtables."""
        return {
            "truth": table.truth,
            "measurements": table.measurements.source,
            "fit_method": table.fit.method,
            "given": table.fit.given,
            "measure_spacing_m": table.measurements.spacing_m,
            "share_measurements": table.measurements.shared,
        }


def raster_truth_of(truth: RasterTruth, radio: BaseStation) -> RasterTruth:
    """Return the map of a station: the common one, overridden by the station's own keys."""
    return replace(
        truth, file=radio.gain_file or truth.file, variable=radio.gain_variable or truth.variable
    )


def log_of(log: LoggedMeasurements, radio: BaseStation) -> LoggedMeasurements:
    """Return the log of a station: the common log, overridden by the station's own keys."""
    # The censored column of a common log applies to its default power column only.
    x, y, power = log.log_format.columns
    shared = radio.log_file is None and radio.power_column is not None
    where, column = log.log_format.where, log.transmitter_column
    if column is not None:
        where = (*where, (column, radio.transmitter or radio.name))
    log_format = replace(
        log.log_format,
        columns=(x, y, radio.power_column or power),
        censored_column=radio.censored_column
        or (None if shared else log.log_format.censored_column),
        where=where,
    )
    return replace(log, file=radio.log_file or log.file, log_format=log_format)


@dataclass(frozen=True, kw_only=True)
class BaseStation(Part):
    """Base station, access point or gateway at a fixed position.

    Examples
    --------
    >>> from planopt import BaseStation
    >>> mast = BaseStation(position_m=(40, 0), transmit_power_dbm=30.0, threshold_dbm=-83.0)
    >>> mast.name, mast.height_m
    ('station', 0.0)
    """

    at = "stations[]"

    position_m: Pair
    """Position [x, y] in metres; it may be outside the bounds."""
    position_known: bool = True
    """False if position_m is a placeholder, because the log that should locate the station does not
    determine it. Commands then warn; the channel is fitted as if the position were right."""
    height_m: Metres = 0.0
    """Height of the station antenna above the robots' antennas in metres."""
    transmit_power_dbm: Decibels
    """Transmit power in dBm; the received power is the sum of transmit power and path gain."""
    threshold_dbm: Decibels
    """Connection threshold in dBm of the received power, as used by planner and verifier."""
    receive_threshold_dbm: Decibels | None = None
    """True connection threshold in dBm in simulations, if it differs from threshold_dbm."""
    name: Name = "station"
    """Name in outputs."""
    gain_file: FilePath | None = None
    """Map of the station's path gains if channel.truth is a raster, in place of channel.truth.file.
    Each station needs its own map."""
    gain_variable: Annotated[str | None, Field(min_length=1)] = None
    """Name of the station's path gain in dB; replaces channel.truth.variable."""
    log_file: FilePath | None = None
    """CSV log of the station's initial measurements, in place of channel.measurements.file, whose
    default is the first log_file. Each station needs its own log or power_column."""
    power_column: Annotated[str | None, Field(min_length=1)] = None
    """Column of the station's power in dBm; replaces channel.measurements.columns.power."""
    transmitter: Annotated[str | None, Field(min_length=1)] = None
    """Name of the station in the log's column channel.measurements.transmitter_column; default: the
    station's name."""
    censored_column: Annotated[str | None, Field(min_length=1)] = None
    """Column that marks the station's censored rows; the default for its own log is the one of
    channel.measurements."""

    @property
    def true_threshold_dbm(self) -> float:
        """Return the true connection threshold of the received power."""
        least = self.receive_threshold_dbm
        return self.threshold_dbm if least is None else least

    @property
    def site(self) -> Station:
        """Return the antenna position for the channel model."""
        return Station(self.position_m, self.height_m)
