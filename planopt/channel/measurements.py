"""Power measurements: a table of positions and powers with their errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import MAX_COORDINATE_M
from planopt.errors import InputError, listed
from planopt.short_repr import short_repr

MAX_POWER_DB = 1e6
"""Maximum magnitude of a power, so that squares do not overflow."""

LEAST_POWER_DBM, LARGEST_POWER_DBM = -300.0, 100.0
"""Range of powers that a receiver can report, from below the noise floor of any bandwidth to ten
megawatts."""


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

    positions_m: NDArray[np.float64]
    power_dbm: NDArray[np.float64]
    censored: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    resolution_db: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    position_std_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    time_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    receiver: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

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
                    f"{count} measurements and {name} of shape {values.shape}",
                    remedy=f"give {name} (n,), or leave it out",
                )
        if self.positions_m.shape != (count, 2) or self.power_dbm.shape != (count,):
            raise InputError(
                f"positions of shape {self.positions_m.shape} and powers of shape "
                f"{self.power_dbm.shape} do not belong together",
                remedy="give positions (n, 2) and powers (n,), e.g. [[5.0, 2.0]] and [-61.5] for "
                "one measurement",
            )
        finite = np.isfinite(self.positions_m).all(axis=1) & np.isfinite(self.power_dbm)
        if not finite.all():
            raise InputError(
                f"measurement {np.argmin(finite)} of {count} is not finite",
                key="measurements",
                remedy="remove it or mark it censored",
            )
        for values, most in ((self.positions_m, MAX_COORDINATE_M), (self.power_dbm, MAX_POWER_DB)):
            if (np.abs(values) > most).any():
                raise InputError(
                    f"a coordinate or power of {np.abs(values).max():g} is none",
                    remedy="give coordinates in metres and powers in dBm",
                )
        if not np.isfinite(self.time_s).all():
            raise InputError("the time of a measurement is not finite", remedy="remove it")
        for name in ("resolution_db", "position_std_m"):
            values = getattr(self, name)
            if not (np.isfinite(values).all() and (values >= 0.0).all()):
                raise InputError(f"a {name} is negative or not finite", remedy="use 0 for none")

    def __len__(self) -> int:
        return len(self.power_dbm)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Measurements:
        """Return the measurements of `rows`: indices, a mask or a slice."""
        return Measurements(*(getattr(self, part.name)[rows] for part in fields(self)))

    def by_place(self) -> Measurements:
        """Return the measurements sorted by x, then y, power and the other columns."""
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
            f"a {type(data).__name__} has no measurements",
            key="measurements",
            remedy="give Measurements, a DataFrame, or a dictionary of columns",
        ) from None
    for name in ("x_m", "y_m", "power_dbm"):
        if name not in names:
            raise InputError(
                f"there is no column {name!r} among {listed(names)}",
                key="measurements",
                remedy="name the columns x_m, y_m and power_dbm",
            )
    axes = [_array(name, data[name]) for name in ("x_m", "y_m")]
    if axes[0].ndim != 1 or axes[0].shape != axes[1].shape:
        shapes = " and ".join(str(values.shape) for values in axes)
        raise InputError(
            f"x_m and y_m are no columns of equal length: their shapes are {shapes}",
            key="measurements",
            remedy="give a list of one number for each measurement, e.g. [5.0] for a single one",
        )
    more = {part.name: data[part.name] for part in fields(Measurements)[2:] if part.name in names}
    return Measurements(np.column_stack(axes), data["power_dbm"], **more)


def as_received(data: Measurements | Table) -> Measurements:
    """Convert as :func:`as_measurements`; raise an error if a receiver cannot report a power."""
    received = as_measurements(data)
    power = received.power_dbm
    within = (power >= LEAST_POWER_DBM) & (power <= LARGEST_POWER_DBM)
    if not within.all():
        row = int(np.argmin(within))
        raise InputError(
            f"power {power[row]:g} dBm of measurement {row} is not between "
            f"{LEAST_POWER_DBM:g} and {LARGEST_POWER_DBM:g}",
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
        raise InputError(
            f"{name} is no array of {words}", key=name, remedy=f"give {words}"
        ) from None
    return found


def join(first: Measurements, second: Measurements) -> Measurements:
    """Join two sets of measurements, `first` before `second`."""
    # Both are valid already; validating 50,000 rows again takes longer than a planner's map.
    joined = object.__new__(Measurements)
    for part in fields(Measurements):
        both = (getattr(first, part.name), getattr(second, part.name))
        object.__setattr__(joined, part.name, np.concatenate(both))
    return joined
