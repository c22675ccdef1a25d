"""The parameters that a set of measurements can identify, asked before any estimation.

Five parameters are wanted (K_PL, n_PL, xi, beta, omega). Which of them the positions allow is a
question of geometry and counts; the answer decides what is fitted and what is set to a prior, and
gives the user the reason in words.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurements import Measurements
from planopt.channel.parameters import Station, regressors
from planopt.errors import InputError

MIN_MEASUREMENTS_THETA = 3
"""Path loss is a line: two points always fit it and say nothing of the error."""

MIN_MEASUREMENTS_COVARIANCE = 6
"""xi, beta and omega need more values than the five parameters."""

MIN_REGRESSOR_SPREAD_DB = 0.2
"""n_PL is identifiable when 10 log10 d varies by more than this (distances by 5 %)."""

LEAST_EXTENT_M = 1e-6
"""Positions within a micrometre of each other are one place: squares of their distances would be
lost to rounding."""

FALLBACK_DECORRELATION_M = 10.0
"""beta where there is not even a spacing to go by."""


@dataclass(frozen=True)
class Identifiability:
    """The parameters that the measurements can identify, and why not the others."""

    n_pl_reason: str | None  # Why n_PL cannot be estimated, or None
    covariance_reason: str | None  # Why xi, beta and omega cannot be estimated, or None
    extent_m: float  # Diagonal of the bounding box of all positions
    # Shortest and longest beta that these positions could tell from none and from endless: a third
    # of the smallest useful spacing (where correlation has fallen to 5 %), and the extent
    decorrelation_bounds_m: tuple[float, float]


def examine(measurements: Measurements, station: Station) -> Identifiability:
    """Say what `measurements` can tell about the channel to `station`."""
    require_usable(measurements, station)
    exact = ~measurements.censored
    positions = measurements.positions_m[exact]
    count = len(positions)
    distinct = np.unique(measurements.positions_m, axis=0)
    extent = float(np.hypot(*np.ptp(distinct, axis=0)))
    return Identifiability(
        _n_pl_reason(positions, station, count),
        _covariance_reason(positions, count),
        extent,
        _decorrelation_bounds_m(distinct, extent),
    )


def require_usable(measurements: Measurements, station: Station | None) -> None:
    """Refuse measurements from which nothing can be estimated; raises as :func:`examine`."""
    count = len(measurements)
    if count == 0:
        raise InputError("there are no measurements", remedy="give at least three")
    if station is not None:
        offset = measurements.positions_m - np.asarray(station.position_m)
        at_station = np.flatnonzero((offset**2).sum(axis=1) + station.height_m**2 == 0.0)
        if len(at_station):
            index = int(at_station[0])
            raise InputError(
                f"measurement {index} (counted from 0) is exactly at the station: "
                "log of zero distance",
                row=index,
                remedy="correct the position, or give the station's height",
            )
    if count > 1 and np.ptp(measurements.positions_m, axis=0).max() < LEAST_EXTENT_M:
        raise InputError(
            f"all {count} measurements are in one place",
            remedy="measure at different distances from the station",
        )


def _n_pl_reason(positions: NDArray[np.float64], station: Station, count: int) -> str | None:
    """Return why the line of power against log-distance has no slope to estimate."""
    if count < MIN_MEASUREMENTS_THETA:
        return f"{count} uncensored measurements are fewer than {MIN_MEASUREMENTS_THETA}"
    if float(np.ptp(regressors(positions, station)[:, 1])) < MIN_REGRESSOR_SPREAD_DB:
        return "all uncensored measurements are at one distance from the station"
    return None


def _covariance_reason(positions: NDArray[np.float64], count: int) -> str | None:
    """Return why there is no empirical covariance to fit."""
    if count < MIN_MEASUREMENTS_COVARIANCE:
        return f"{count} uncensored measurements are fewer than {MIN_MEASUREMENTS_COVARIANCE}"
    if len(np.unique(positions, axis=0)) < MIN_MEASUREMENTS_THETA:
        return "the uncensored measurements are in fewer than three places"
    return None


def _decorrelation_bounds_m(distinct: NDArray[np.float64], extent_m: float) -> tuple[float, float]:
    """Bounds of beta from distinct positions (n, 2)."""
    if len(distinct) < 2:
        return FALLBACK_DECORRELATION_M, FALLBACK_DECORRELATION_M
    # Not the least spacing: two fixes a centimetre apart say nothing of the design.
    spacing = max(float(np.quantile(nearest_distance_m(distinct), 0.05)), LEAST_EXTENT_M)
    return min(spacing, extent_m) / 3.0, extent_m


def nearest_distance_m(positions_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of each of two or more positions (n, 2) to its nearest other one; (n,)."""
    from scipy.spatial import KDTree

    found = KDTree(positions_m).query(positions_m, k=2)  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    return np.asarray(found[0], dtype=np.float64)[:, 1]  # pyright: ignore[reportUnknownArgumentType]
