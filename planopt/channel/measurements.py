"""Power measurements: where, how much, and whether the value is only an upper limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError


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

    Raises
    ------
    InputError
        Shapes do not agree, or a number is not finite.
    """

    positions_m: NDArray[np.float64]
    power_dbm: NDArray[np.float64]
    censored: NDArray[np.bool_]

    def __post_init__(self) -> None:
        count = len(self.power_dbm)
        if self.positions_m.shape != (count, 2) or self.censored.shape != (count,):
            raise InputError(
                f"measurements of shapes {self.positions_m.shape}, {self.power_dbm.shape} and "
                f"{self.censored.shape} do not belong together",
                remedy="give positions (n, 2), power (n,) and censored (n,)",
            )
        if not (np.isfinite(self.positions_m).all() and np.isfinite(self.power_dbm).all()):
            raise InputError("a measurement is not finite", remedy="remove it or mark it censored")

    def __len__(self) -> int:
        return len(self.power_dbm)


def join(first: Measurements, second: Measurements) -> Measurements:
    """Both sets, `first` before `second`."""
    return Measurements(
        np.concatenate([first.positions_m, second.positions_m]),
        np.concatenate([first.power_dbm, second.power_dbm]),
        np.concatenate([first.censored, second.censored]),
    )
