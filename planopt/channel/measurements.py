"""Power measurements: where, how much, and how much each is worth."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from planopt.channel.places import MAX_COORDINATE_M
from planopt.errors import InputError
from planopt.short_repr import short_repr

MAX_POWER_DB = 1e6
"""No power is further from 0 dBm: far beyond, its squares overflow."""


@dataclass(frozen=True)
class Measurements:
    """Received power at known positions (the seed's Q and Y).

    Attributes
    ----------
    positions_m
        ``(n, 2)`` metres.
    power_dbm
        ``(n,)`` received power in dBm.
    censored
        ``(n,)`` true where the power is only known to be *at most* ``power_dbm`` (the receiver's
        floor).
    resolution_db
        ``(n,)`` step of the receiver's scale: the power is within half of it of ``power_dbm``;
        zero for a power that was not rounded. Not given: all zero.
    position_std_m
        ``(n,)`` deviation of the error of either coordinate (GPS). Not given: all zero.
    time_s
        ``(n,)`` when it was taken, for channels that drift. Not given: all zero.
    receiver
        ``(n,)`` number of the receiver; 0 is the one that powers are predicted for, others may
        have an offset. Not given: all 0.

    Raises
    ------
    InputError
        Shapes do not agree, a number is not finite, a coordinate or a power is beyond
        `MAX_COORDINATE_M` or `MAX_POWER_DB`, or a resolution or deviation is negative.
    """

    positions_m: NDArray[np.float64]
    power_dbm: NDArray[np.float64]
    censored: NDArray[np.bool_]
    resolution_db: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    position_std_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    time_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    receiver: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    __repr__ = short_repr

    def __post_init__(self) -> None:
        count = len(self.power_dbm)
        for name in ("resolution_db", "position_std_m", "time_s", "receiver"):
            values = getattr(self, name)
            if values.shape == (0,) and count:
                object.__setattr__(self, name, np.zeros(count, dtype=values.dtype))
            elif values.shape != (count,):
                raise InputError(
                    f"{count} measurements and {name} of shape {values.shape}",
                    remedy=f"give {name} (n,), or leave it out",
                )
        if self.positions_m.shape != (count, 2) or self.censored.shape != (count,):
            raise InputError(
                f"measurements of shapes {self.positions_m.shape}, {self.power_dbm.shape} and "
                f"{self.censored.shape} do not belong together",
                remedy="give positions (n, 2), power (n,) and censored (n,)",
            )
        if not (np.isfinite(self.positions_m).all() and np.isfinite(self.power_dbm).all()):
            raise InputError("a measurement is not finite", remedy="remove it or mark it censored")
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
        """Those of `rows`: indices, a mask or a slice."""
        return Measurements(*(getattr(self, part.name)[rows] for part in fields(self)))

    def by_place(self) -> Measurements:
        """The same in an order that depends on what they are, not on that of the rows.

        By x, then y; where they agree by power and the rest.
        """
        others = (getattr(self, part.name) for part in reversed(fields(self)[1:]))
        return self.take(np.lexsort((*others, self.positions_m[:, 1], self.positions_m[:, 0])))


def join(first: Measurements, second: Measurements) -> Measurements:
    """Both sets, `first` before `second`."""
    # Both have been checked. To check 50,000 again takes longer than a planner's map.
    joined = object.__new__(Measurements)
    for part in fields(Measurements):
        both = (getattr(first, part.name), getattr(second, part.name))
        object.__setattr__(joined, part.name, np.concatenate(both))
    return joined
