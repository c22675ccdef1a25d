"""Checks of what callers give: places and levels that can be computed with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.errors import InputError

MAX_COORDINATE_M = 1e12
"""No coordinate is larger: far beyond, squares of distances overflow."""


def require_places(positions_m: ArrayLike, at_least: int = 1) -> NDArray[np.float64]:
    """`positions_m` as floats, or an error that says what is wrong with them."""
    # Shapes: positions_m (h, 2).
    try:
        places = np.asarray(positions_m, dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError(
            "positions are no array of numbers",
            key="positions_m",
            remedy=f"give (h, 2) metres with h at least {at_least}",
        ) from None
    if places.ndim != 2 or places.shape[1] != 2 or len(places) < at_least:
        raise InputError(
            f"positions of shape {places.shape} are no places",
            key="positions_m",
            remedy=f"give (h, 2) metres with h at least {at_least}",
        )
    if not np.isfinite(places).all():
        raise InputError("a position is not finite", key="positions_m", remedy="leave it out")
    if (np.abs(places) > MAX_COORDINATE_M).any():
        raise InputError(
            "a position is too far away",
            key="positions_m",
            remedy=f"give coordinates within {MAX_COORDINATE_M:g} m",
        )
    return places


def require_finite(value: float, key: str) -> float:
    """`value` as a float."""
    if not math.isfinite(value):
        raise InputError(f"{value!r} is not finite", key=key, remedy="give a number")
    return float(value)


def require_shadowing(shadow_std_db: float, decorrelation_m: float) -> None:
    """Refuse what is no shadowing."""
    if not (math.isfinite(shadow_std_db) and shadow_std_db >= 0.0):
        raise InputError(
            f"{shadow_std_db!r} dB is no deviation",
            key="shadow_std_db",
            remedy="give a value of at least 0, e.g. 8",
        )
    if not (math.isfinite(decorrelation_m) and decorrelation_m > 0.0):
        raise InputError(
            f"{decorrelation_m!r} m is no distance",
            key="decorrelation_m",
            remedy="give a value above 0, e.g. 10",
        )


def require_count(count: int, key: str) -> int:
    """`count` as it is."""
    if count < 1:
        raise InputError(f"{count!r} is too few", key=key, remedy="give at least 1")
    return count


def leg_lengths_m(positions_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of the straight legs between successive places; (h, 2) -> (h - 1,)."""
    step = np.diff(positions_m, axis=0)
    return np.hypot(step[:, 0], step[:, 1])
