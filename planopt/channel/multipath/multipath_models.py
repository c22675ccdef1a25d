"""The distributions of multipath: lognormal, Nakagami-m and Rician (Rayleigh at K = 0).

Of unit mean power, the mean in dB subtracted as the field does (equation 1.5), so that the
predicted mean stays what it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import (  # pyright: ignore[reportUnknownVariableType]
    chndtr,
    gammaincc,
    ndtr,
)

from planopt.channel.multipath.fading import rician_mean_db, rician_std_db
from planopt.channel.multipath.multipath_conversions import (
    nakagami_mean_db,
    nakagami_std_db,
    require_k_factor,
    require_m,
)
from planopt.errors import InputError


@dataclass(frozen=True)
class Lognormal:
    """Gaussian in dB.

    Attributes
    ----------
    std_db
        omega, at least 0.
    """

    std_db: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.std_db < math.inf:
            raise InputError(f"{self.std_db!r} is no deviation", key="std_db")


@dataclass(frozen=True)
class Nakagami:
    """Gamma distributed power.

    Attributes
    ----------
    m
        At least 0.5.
    """

    m: float

    def __post_init__(self) -> None:
        require_m(self.m)

    @property
    def std_db(self) -> float:
        """Exact omega."""
        return nakagami_std_db(self.m)


@dataclass(frozen=True)
class Rician:
    """A constant amplitude plus scatter.

    Attributes
    ----------
    k_factor
        K >= 0, ratio of their powers; 0 is Rayleigh fading.
    """

    k_factor: float

    def __post_init__(self) -> None:
        require_k_factor(self.k_factor)

    @property
    def std_db(self) -> float:
        """Exact omega."""
        return rician_std_db(self.k_factor)


Multipath = Lognormal | Nakagami | Rician


def multipath_survival(multipath: Multipath, level_db: NDArray[np.float64]) -> NDArray[np.float64]:
    """P(fading >= level), fading in dB with its mean subtracted; shape of `level_db`."""
    # Above 300 dB a power's chance is nil, and its square would overflow.
    level = np.minimum(level_db, 300.0)
    match multipath:
        case Lognormal(0.0):
            return np.where(level <= 0.0, 1.0, 0.0)
        case Lognormal(std_db):
            return _array(ndtr(-level / std_db))
        case Nakagami(m):
            power = 10.0 ** ((level + nakagami_mean_db(m)) / 10.0)
            return _array(gammaincc(m, m * power))
        case Rician(k_factor):
            # Twice (K + 1) times the power is noncentral chi-square of two degrees of freedom.
            power = 10.0 ** ((level + rician_mean_db(k_factor)) / 10.0)
            return 1.0 - _array(chndtr(2.0 * (k_factor + 1.0) * power, 2.0, 2.0 * k_factor))


def _array(values: object) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
