"""Power measurements with their errors, and covariances of measured and predicted powers.

Apart from multipath, two measured powers have the covariance (equations 1.13 to 1.15)

    xi^2 exp(-sqrt(d^2 + c_i + c_j) / beta) exp(-|t_i - t_j| / T) + s^2 [same receiver, not 0]

with T the forgetting time, s the prior standard deviation of a receiver's offset, and
c = 1.2 sigma^2 for a recorded position with errors of standard deviation sigma per coordinate.
Predictions are for receiver 0, the reference, and have no offset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.parameters import MAX_COORDINATE_M, ChannelParameters, Station
from planopt.errors import InputError, listed
from planopt.short_repr import short_repr

MAX_POWER_DB = 1e6  # Maximum magnitude of a power, so that squares do not overflow
SAME_PLACE_M = 1e-6  # Distance in metres below which two positions count as one
LEAST_POWER_DBM, LARGEST_POWER_DBM = -300.0, 100.0  # Range of powers that a receiver can report


class Frame(Protocol):
    """Table with named columns, such as a DataFrame of pandas or polars."""

    @property
    def columns(self) -> Any:
        """Names of the columns."""
        ...

    def __getitem__(self, name: str, /) -> Any:
        """Return a column by name."""
        ...


Table = Mapping[str, Any] | Frame
"""Table with columns of equal length: a dictionary of lists or arrays, or a DataFrame."""


@dataclass(frozen=True)
class Measurements:
    """Measurements of received power at known positions (Y of equation 1.3).

    Columns may be lists or columns of a DataFrame; :func:`as_measurements` converts whole tables.

    Attributes
    ----------
    positions_m
        ``(n, 2)`` positions in metres.
    power_dbm
        ``(n,)`` received power in dBm.
    censored
        ``(n,)`` true for left-censored powers, for which ``power_dbm`` is only an upper limit (the
        receiver's sensitivity). Default: all false.
    resolution_db
        ``(n,)`` rounding step of the receiver; the power is within half a step of ``power_dbm``.
        Zero for an unrounded power. Default: all zero.
    position_std_m
        ``(n,)`` standard deviation of the position error per coordinate (GPS). Default: all zero.
    time_s
        ``(n,)`` time of the measurement, for time-varying channels. Default: all zero.
    receiver
        ``(n,)`` number of the receiver. Predictions are for number 0; others may have an offset.
        Default: all 0.

    Raises
    ------
    InputError
        A column is not a numeric array, shapes differ, a number is not finite, a coordinate exceeds
        `MAX_COORDINATE_M` or a power `MAX_POWER_DB`, or a resolution or standard deviation is
        negative.
    """

    positions_m: Floats
    power_dbm: Floats
    censored: Mask = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    resolution_db: Floats = field(default_factory=lambda: np.zeros(0))
    position_std_m: Floats = field(default_factory=lambda: np.zeros(0))
    time_s: Floats = field(default_factory=lambda: np.zeros(0))
    receiver: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for part in fields(self):
            object.__setattr__(self, part.name, _array(part.name, getattr(self, part.name)))
        count = self.power_dbm.size
        for name in ("censored", "resolution_db", "position_std_m", "time_s", "receiver"):
            values = getattr(self, name)
            if values.shape == (0,) and count:
                object.__setattr__(self, name, np.zeros(count, dtype=values.dtype))
            elif values.shape != (count,):
                raise InputError(
                    f"{name} has shape {values.shape}, but there are {count} measurements",
                    remedy=f"give one value for each measurement, or leave {name} out",
                )
        if self.positions_m.shape != (count, 2) or self.power_dbm.shape != (count,):
            raise InputError(
                f"positions of shape {self.positions_m.shape} and powers of shape "
                f"{self.power_dbm.shape} do not match",
                remedy="give positions (n, 2) and powers (n,), e.g. [[5.0, 2.0]] and [-61.5] for "
                "one measurement",
            )
        finite = np.isfinite(self.positions_m).all(axis=1) & np.isfinite(self.power_dbm)
        if not finite.all():
            raise InputError(
                f"the position or power of measurement {np.argmin(finite)} of {count} (counted "
                "from 0) is NaN or infinite",
                key="measurements",
                remedy="remove the measurement, or mark it as censored at the receiver's "
                "sensitivity",
            )
        for what, values, most, unit in (
            ("coordinate", self.positions_m, MAX_COORDINATE_M, "m"),
            ("power", self.power_dbm, MAX_POWER_DB, "dBm"),
        ):
            if (np.abs(values) > most).any():
                raise InputError(
                    f"a {what} of {np.abs(values).max():g} {unit} is out of range",
                    remedy=f"give {unit}, at most {most:g} in magnitude",
                )
        if not np.isfinite(self.time_s).all():
            raise InputError(
                "the time of a measurement is NaN or infinite",
                remedy="remove the measurement, or give its time in seconds",
            )
        for name in ("resolution_db", "position_std_m"):
            values = getattr(self, name)
            if not (np.isfinite(values).all() and (values >= 0.0).all()):
                raise InputError(
                    f"a value of {name} is negative, NaN or infinite",
                    remedy="give 0 for exact values",
                )

    def __len__(self) -> int:
        return len(self.power_dbm)

    def take(self, rows: Indices | Mask | slice) -> Measurements:
        """Return the measurements of `rows`: indices, a mask or a slice."""
        return Measurements(*(getattr(self, part.name)[rows] for part in fields(self)))

    def by_place(self) -> Measurements:
        """Return the measurements sorted by x, then y, power and the remaining columns."""
        others = (getattr(self, part.name) for part in reversed(fields(self)[1:]))
        return self.take(np.lexsort((*others, self.positions_m[:, 1], self.positions_m[:, 0])))


def as_measurements(data: Measurements | Table) -> Measurements:
    """Return measurements unchanged, or convert a table to measurements."""
    if isinstance(data, Measurements):
        return data
    try:
        names = list(data if isinstance(data, Mapping) else data.columns)
    except (AttributeError, TypeError):
        raise InputError(
            f"is of type {type(data).__name__}, which is not a table of measurements",
            key="measurements",
            remedy="give Measurements, a DataFrame or a dictionary of columns",
        ) from None
    for name in ("x_m", "y_m", "power_dbm"):
        if name not in names:
            raise InputError(
                f"the column {name!r} is missing; the columns are {listed(names)}",
                key="measurements",
                remedy="name the columns x_m, y_m and power_dbm",
            )
    axes = [_array(name, data[name]) for name in ("x_m", "y_m")]
    if axes[0].ndim != 1 or axes[0].shape != axes[1].shape:
        shapes = " and ".join(str(values.shape) for values in axes)
        raise InputError(
            f"x_m and y_m differ in length: their shapes are {shapes}",
            key="measurements",
            remedy="give one number for each measurement, e.g. [5.0] for a single one",
        )
    more = {part.name: data[part.name] for part in fields(Measurements)[2:] if part.name in names}
    return Measurements(np.column_stack(axes), data["power_dbm"], **more)


def as_received(data: Measurements | Table) -> Measurements:
    """Convert a table to measurements; raise an error for powers outside a receiver's range."""
    received = as_measurements(data)
    power = received.power_dbm
    within = (power >= LEAST_POWER_DBM) & (power <= LARGEST_POWER_DBM)
    if not within.all():
        row = int(np.argmin(within))
        raise InputError(
            f"the power of measurement {row} (counted from 0) is {power[row]:g}, outside "
            f"{LEAST_POWER_DBM:g} to {LARGEST_POWER_DBM:g} dBm",
            key="measurements.power_dbm",
            remedy="give powers in dBm",
        )
    return received


_KINDS: dict[str, tuple[type[np.generic], str]] = {
    "censored": (np.bool_, "true or false"),
    "receiver": (np.intp, "whole numbers"),
}
"""Types of the fields that are not floats, with their names in messages."""


def _array(name: str, values: Any) -> NDArray[Any]:
    """Return the values of a field as an array of the field's type."""
    kind, words = _KINDS.get(name, (np.float64, "numbers"))
    try:
        array = np.asarray(values)
        # Numbers as text are rejected: the column was not converted.
        text = array.dtype.kind == "O" and any(isinstance(value, str) for value in array.flat)
        if text or array.dtype.kind not in "biufO":
            raise ValueError
        found = array.astype(kind, copy=False)
        if kind is not np.float64 and not np.array_equal(found, array):
            raise ValueError
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"is not an array of {words}", key=name, remedy=f"give {words}") from None
    return found


def join(first: Measurements, second: Measurements) -> Measurements:
    """Join two sets of measurements, `first` before `second`."""
    # Both sets are valid; validating 50,000 rows again takes longer than a planner's map.
    joined = object.__new__(Measurements)
    for part in fields(Measurements):
        both = (getattr(first, part.name), getattr(second, part.name))
        object.__setattr__(joined, part.name, np.concatenate(both))
    return joined


Real = TypeVar("Real", np.float32, np.float64)

BLUR_SHARE = 1.2
"""Increase of a squared distance per unit variance of the position error in one coordinate."""
RECEIVERS_APART_S = 1e9  # Time between receivers, whose lasting multipath is independent
RECEIVER_OFFSET_STD_DB = 20.0
"""Prior standard deviation s of a receiver's offset, large enough to be uninformative."""
ROWS_AT_ONCE = 64
"""Number of rows of a large symmetric matrix computed together, up to the diagonal."""


def pairwise_distance_m(a: Floats, b: Floats, blur_m2: Floats | None = None) -> Floats:
    """Return distances (..., n, m) between rows of `a` (..., n, 2) and `b` (..., m, 2)."""
    # Differences are squared without expanding, so that coordinates near 3e6 keep digits.
    dx = a[..., :, None, 0] - b[..., None, :, 0]
    dy = a[..., :, None, 1] - b[..., None, :, 1]
    dx *= dx
    dy *= dy
    dx += dy
    if blur_m2 is not None:
        dx += blur_m2
    return np.sqrt(dx, out=dx)


def shadow_covariance_db2(
    a: Floats, b: Floats, parameters: ChannelParameters, blur_m2: Floats | None = None
) -> Floats:
    """Return the covariance (..., n, m) of shadowing between positions `a` and `b`."""
    return decayed_db2(pairwise_distance_m(a, b, blur_m2), parameters)


def decayed_db2(distance_m: NDArray[Real], parameters: ChannelParameters) -> NDArray[Real]:
    """Overwrite distances of any shape with the covariance of shadowing at these distances."""
    covariance = distance_m
    covariance *= -1.0 / parameters.decorrelation_m
    np.exp(covariance, out=covariance)
    covariance *= parameters.shadow_std_db**2
    return covariance


def path_loss_variance_db2(
    positions_m: Floats,  # (..., 2)
    position_std_m: Floats,  # (...) sigma
    station: Station,
    n_pl: float,
) -> Floats:
    """Return the variance (...) of path loss in dB^2 due to position errors."""
    # ``(10 n_PL / ln 10)^2 sigma^2 (rho^2 + sigma^2) / (rho^2 + h^2 + 2 sigma^2)^2`` with rho the
    # horizontal distance to the station and h its height. It is the variance of the squared
    # distance divided by four times its squared mean. Near the station it is bounded and too small:
    # by 8 % at a distance of 7 sigma, by 43 % at sigma.
    horizontal = ((positions_m - np.asarray(station.position_m)) ** 2).sum(axis=-1)
    variance = position_std_m**2
    mean = horizontal + station.height_m**2 + 2.0 * variance
    share = variance * (horizontal + variance)
    found = np.zeros_like(share)
    np.divide(share, mean**2, out=found, where=variance > 0.0)
    return (10.0 * n_pl / math.log(10.0)) ** 2 * found


def measured_path_loss_variance_db2(
    measurements: Measurements, parameters: ChannelParameters
) -> Floats:
    """Return the variance (n,) of path loss in dB^2 due to position errors."""
    return path_loss_variance_db2(
        measurements.positions_m, measurements.position_std_m, parameters.station, parameters.n_pl
    )


@dataclass(frozen=True, eq=False)
class Origins:
    """Positions, times and receivers of powers, from which covariances are computed."""

    positions_m: Floats  # (..., n, 2)
    # (..., n) increase of squared distances due to position errors; None without errors
    blur_m2: Floats | None = None
    time_s: Floats | None = None  # (..., n), or (1,) for all; None for a static channel
    receiver: Indices | None = None  # (..., n); None if all are 0
    # (..., n) times, far apart for different receivers; None without lasting multipath
    lasting_s: Floats | None = None

    def at(self, rows: Indices | slice) -> Origins:
        """Return the origins with indices `rows`; indices (k, m) give k batches of m origins."""
        return Origins(
            self.positions_m[rows],
            None if self.blur_m2 is None else self.blur_m2[rows],
            None if self.time_s is None else self.time_s[rows],
            None if self.receiver is None else self.receiver[rows],
            None if self.lasting_s is None else self.lasting_s[rows],
        )

    def without_offsets(self) -> Origins:
        """Return the origins without receivers, so that covariances exclude receiver offsets."""
        return self if self.receiver is None else replace(self, receiver=None)


def measured_origins(measurements: Measurements, parameters: ChannelParameters) -> Origins:
    """Return the origins of measurements; fields that do not affect covariances are None."""
    std_m = measurements.position_std_m
    return Origins(
        measurements.positions_m,
        BLUR_SHARE * std_m**2 if std_m.any() else None,
        None if math.isinf(parameters.forgetting_s) else measurements.time_s,
        measurements.receiver if measurements.receiver.any() else None,
        measurements.time_s + RECEIVERS_APART_S * measurements.receiver
        if parameters.lasting
        else None,
    )


def place_origins(
    positions_m: Floats,  # (..., n, 2)
    now_s: float,
    parameters: ChannelParameters,
    position_std_m: Floats | None = None,  # (..., n) of position errors
) -> Origins:
    """Return the origins of predictions: positions, position errors and the time `now_s`."""
    return Origins(
        positions_m,
        None if position_std_m is None else BLUR_SHARE * position_std_m**2,
        None if math.isinf(parameters.forgetting_s) else np.array([now_s]),
    )


def covariance_db2(first: Origins, second: Origins, parameters: ChannelParameters) -> Floats:
    """Return the covariance (..., n, m) of powers at `first` (..., n) and `second` (..., m)."""
    blur_m2 = _blur_m2(first, second)
    distance_m = pairwise_distance_m(first.positions_m, second.positions_m, blur_m2)
    return covariance_over_db2(distance_m, first, second, parameters)


def covariance_over_db2(
    distance_m: Floats, first: Origins, second: Origins, parameters: ChannelParameters
) -> Floats:
    """Overwrite distances (..., n, m), position errors included, with covariances of powers."""
    covariance = decayed_db2(distance_m, parameters)
    if first.time_s is not None and second.time_s is not None:
        covariance *= ageing(first.time_s[..., :, None], second.time_s[..., None, :], parameters)
    if first.receiver is not None and second.receiver is not None:
        covariance += offset_covariance_db2(first.receiver, second.receiver)
    if parameters.lasting and first.lasting_s is not None and second.lasting_s is not None:
        gap_s = np.abs(first.lasting_s[..., :, None] - second.lasting_s[..., None, :])
        lasting_db2 = parameters.lasting.share * parameters.multipath_std_db**2
        covariance += lasting_db2 * np.exp(gap_s / -parameters.lasting.time_s)
    return covariance


def offset_covariance_db2(first: Indices, second: Indices) -> Floats:
    """Return the covariance (..., n, m) of the offsets of receivers `first` and `second`."""
    one, other = first[..., :, None], second[..., None, :]
    return np.where((one == other) & (one != 0), RECEIVER_OFFSET_STD_DB**2, 0.0)


def own_covariance_db2(
    origins: Origins,  # (..., n)
    parameters: ChannelParameters,
    distance_m: Floats | None = None,  # (..., n, n) blurred; None to compute them
) -> Floats:
    """Return the covariance (..., n, n) in dB^2 of the powers at `origins`."""
    count = origins.positions_m.shape[-2]
    if distance_m is not None:
        covariance = covariance_over_db2(distance_m.copy(), origins, origins, parameters)
    elif origins.positions_m.ndim == 2 and count > 2 * ROWS_AT_ONCE:
        covariance = np.empty((count, count))
        for start in range(0, count, ROWS_AT_ONCE):
            stop = min(start + ROWS_AT_ONCE, count)
            rows = slice(start, stop)
            part = covariance_db2(origins.at(rows), origins.at(slice(stop)), parameters)
            covariance[rows, :stop] = part
            covariance[:start, rows] = part[:, :start].T
    else:
        covariance = covariance_db2(origins, origins, parameters)
    if origins.blur_m2 is not None:
        # The distance of a measurement from itself has no position error.
        np.einsum("...ii->...i", covariance)[...] = own_variance_db2(origins, parameters)
    return covariance


def own_variance_db2(origins: Origins, parameters: ChannelParameters) -> Floats:
    """Return the variance (..., n) in dB^2 of shadowing, receiver offset and lasting multipath."""
    variance = np.full(origins.positions_m.shape[:-1], float(parameters.shadow_std_db) ** 2)
    if origins.lasting_s is not None:
        variance += parameters.multipath_std_db**2 - parameters.white_variance_db2
    if origins.receiver is not None:
        variance[origins.receiver != 0] += RECEIVER_OFFSET_STD_DB**2
    return variance


def own_distance_m(origins: Origins) -> Floats:
    """Return distances (n, n) between all pairs of `origins`, increased by position errors."""
    blur_m2 = _blur_m2(origins, origins)
    distance = pairwise_distance_m(origins.positions_m, origins.positions_m, blur_m2)
    np.fill_diagonal(distance, 0.0)
    return distance


def ageing(one_s: Floats | float, other_s: Floats | float, parameters: ChannelParameters) -> Floats:
    """Return the age factor exp(-|t_1 - t_2| / T) for times t_1, t_2 and forgetting time T."""
    gap = np.abs(np.subtract(one_s, other_s))
    return np.exp(-gap / parameters.forgetting_s)


def _blur_m2(first: Origins, second: Origins) -> Floats | None:
    """Return the increase of squared distances due to position errors, broadcast to (..., n, m)."""
    if first.blur_m2 is None:
        return None if second.blur_m2 is None else second.blur_m2[..., None, :]
    if second.blur_m2 is None:
        return first.blur_m2[..., :, None]
    return first.blur_m2[..., :, None] + second.blur_m2[..., None, :]
