"""Between the numbers that multipath is given by: Nakagami's m, Rician K, omega in dB.

All exact (equation 1.5). The pairs (m, omega) of [GM11] are those of Rician K = 5, 10, 30: their
omega is near the Rician one and is not the Nakagami one, so whoever gives m or omega must say
which of both is meant.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import psi, zeta  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.multipath.fading import DB_PER_NEPER, rician_std_db
from planopt.errors import InputError

MIN_M = 0.5
"""Nakagami's distribution is defined from here on; 1 is Rayleigh fading."""

STRONGEST = 1e8
"""K and m are sought up to here; omega is then below 0.001 dB."""

HALVINGS = 60
"""Of the bracket of a sought m or K, to the last digit."""


def nakagami_m_of_rician(k_factor: float) -> float:
    """Nakagami's m = (K + 1)^2 / (2 K + 1), of equal amount of fading.

    Raises
    ------
    InputError
        K is negative or not finite.
    """
    require_k_factor(k_factor)
    # Written so, no rounding takes it below 1, where there is no Rician channel.
    return 1.0 + k_factor**2 / (2.0 * k_factor + 1.0)


def rician_k_of_nakagami(m: float) -> float:
    """Rician K = m - 1 + sqrt(m (m - 1)), the inverse of :func:`nakagami_m_of_rician`.

    Raises
    ------
    InputError
        m is below 1: fading worse than Rayleigh's has no Rician factor.
    """
    if not 1.0 <= m < math.inf:
        raise InputError(f"m = {m!r} has no Rician factor", key="m", remedy="m is at least 1")
    return m - 1.0 + math.sqrt(m * (m - 1.0))


def nakagami_mean_db(m: float) -> float:
    """Mean in dB of Nakagami fading of unit mean power: (10 / ln 10) (psi(m) - ln m); negative.

    Raises
    ------
    InputError
        m is below `MIN_M` or not finite.
    """
    require_m(m)
    return DB_PER_NEPER * (float(_array(psi(m))) - math.log(m))


def nakagami_std_db(m: float) -> float:
    """Deviation omega in dB of Nakagami fading: (10 / ln 10) sqrt(psi'(m)).

    psi'(m) is Hurwitz's zeta(2, m).

    Raises
    ------
    InputError
        m is below `MIN_M` or not finite.
    """
    require_m(m)
    return DB_PER_NEPER * math.sqrt(float(_array(zeta(2.0, m))))


def nakagami_m_of_std(multipath_std_db: float) -> float:
    """The m whose exact deviation is omega = `multipath_std_db`.

    Raises
    ------
    InputError
        No m from `MIN_M` to `STRONGEST` has it.
    """
    return _sought(nakagami_std_db, MIN_M, multipath_std_db)


def rician_k_of_std(multipath_std_db: float) -> float:
    """The K whose exact deviation is omega = `multipath_std_db`.

    Raises
    ------
    InputError
        No K from 0 to `STRONGEST` has it; Rayleigh fading has the largest, 5.57 dB.
    """
    return _sought(rician_std_db, 0.0, multipath_std_db)


def require_k_factor(k_factor: float) -> None:
    """Refuse a K that is negative or not finite."""
    if not 0.0 <= k_factor < math.inf:
        raise InputError(f"K = {k_factor!r} is no Rician factor", key="k_factor", remedy="K >= 0")


def require_m(m: float) -> None:
    """Refuse an m that is below `MIN_M` or not finite."""
    if not MIN_M <= m < math.inf:
        raise InputError(f"m = {m!r} is none of Nakagami's", key="m", remedy=f"m >= {MIN_M}")


def _sought(deviation_db: Callable[[float], float], weakest: float, wanted_db: float) -> float:
    """Where a falling deviation has the wanted value; halving in the logarithm of 1 + argument."""
    most, least = deviation_db(weakest), deviation_db(STRONGEST)
    if not least <= wanted_db <= most:
        raise InputError(
            f"no such fading has a deviation of {wanted_db!r} dB",
            key="multipath_std_db",
            remedy=f"it is from {least:.2g} to {most:.4g} dB",
        )
    low, high = math.log1p(weakest), math.log1p(STRONGEST)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if deviation_db(math.expm1(middle)) > wanted_db:
            low = middle
        else:
            high = middle
    return max(weakest, math.expm1(0.5 * (low + high)))


def _array(values: object) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
