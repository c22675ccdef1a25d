"""Estimate the station's position, both ways of footnote 2 of [GM11].

``line`` takes the errors for independent: least squares of the path loss line over the position and
theta. ``joint`` takes them for shadowing and multipath: maximum likelihood over the position, theta
and the covariance, the last by REML at the position in turn. Both look at a grid first, since the
likelihood has several optima, and climb from the best of its minima with the exact gradient.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.covariance_fit import MIN_VARIANCE_DB2
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.estimation.least_squares import least_squares
from planopt.channel.estimation.likelihood_starts import thinned
from planopt.channel.estimation.reml import MOST_DENSE
from planopt.channel.mean_model import MIN_DISTANCE_M, mean_model
from planopt.channel.measurements import Measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.station.station_surface import (
    StationSurface,
    best_climb,
    climb,
    gauss_newton,
    grid_starts,
    station_surface,
)

StationMethod = Literal["line", "joint"]

SEARCH_MEASUREMENTS = 300
"""The search uses at most this many measurements; its last step at most `MOST_DENSE`."""

JOINT_ROUNDS = 4
"""Most alternations between covariance and position."""

LINE_ROUNDS = 40
"""Most completions of censored powers."""

STILL = 0.1
"""The position stands still when it moves by less than this share of its deviation."""


@one_blas_thread()
def locate(
    measurements: Measurements,
    station_method: StationMethod,
    height_m: float,
    forgetting_s: float,
) -> Station:
    """The most likely position.

    Parameters
    ----------
    measurements
        Enough uncensored ones, not on one line.
    station_method
        ``line`` or ``joint``.
    height_m, forgetting_s
        Given.

    Raises
    ------
    InputError
        The power grows with the distance from every position tried.
    """
    sample = measurements.take(thinned(len(measurements), SEARCH_MEASUREMENTS))
    # Unit weights, and limits taken for powers: good enough to begin with.
    x, y = (float(value) for value in measurements.positions_m.mean(axis=0))
    even = ChannelParameters(0.0, 0.0, 0.0, 1.0, 1.0, Station((x, y), height_m))
    first = replace(sample, censored=np.zeros(len(sample), dtype=np.bool_))
    line = station_surface(first, even, has_prior=False)
    station = line.station(best_climb(line, grid_starts(line)))
    more = measurements.take(thinned(len(measurements), MOST_DENSE))
    if station_method == "line":
        station = _settled_line(more, station)
    else:
        station = _settled_joint(sample, station, forgetting_s)
        if len(more) > len(sample):
            surface = _joint_surface(more, station, forgetting_s)
            station = surface.station(climb(surface, np.asarray(station.position_m))[1])
    return _clear_of(measurements, station)


def line_surface(measurements: Measurements, station: Station) -> StationSurface:
    """Independent errors, of the variance that the line to `station` leaves; n_PL has no prior."""
    model = mean_model(measurements.positions_m, ~measurements.censored, station, True)
    line = least_squares(model, measurements)
    k_pl, n_pl = model.theta(line.coefficients)
    deviation = math.sqrt(max(line.variance_db2, MIN_VARIANCE_DB2))
    parameters = ChannelParameters(k_pl, n_pl, 0.0, 1.0, deviation, station)
    return station_surface(measurements, parameters, has_prior=False)


def _joint_surface(
    measurements: Measurements, station: Station, forgetting_s: float
) -> StationSurface:
    """Errors of the covariance that REML finds with the station there; n_PL has its prior.

    From outside, a station farther off with a larger n_PL looks much the same.
    """
    station = _clear_of(measurements, station)
    fitted = fit_channel(
        measurements, station, forgetting_s=forgetting_s, intervals=False
    ).parameters
    return station_surface(measurements, fitted, has_prior=True)


def _settled_line(measurements: Measurements, station: Station) -> Station:
    """Climb until the completion of censored powers moves the position no more."""
    for _ in range(LINE_ROUNDS):
        surface = line_surface(measurements, station)
        before = np.asarray(station.position_m)
        _, position = climb(surface, before)
        station = surface.station(position)
        if _stands_still(surface, before, position):
            break
    return station


def _settled_joint(measurements: Measurements, station: Station, forgetting_s: float) -> Station:
    """Alternate between the covariance and the position, other optima looked at each time."""
    for _ in range(JOINT_ROUNDS):
        surface = _joint_surface(measurements, station, forgetting_s)
        before = np.asarray(station.position_m)
        position = best_climb(surface, [before, *grid_starts(surface)])
        station = surface.station(position)
        if _stands_still(surface, before, position):
            break
    return station


def _stands_still(
    surface: StationSurface, before: NDArray[np.float64], after: NDArray[np.float64]
) -> bool:
    """Whether the move is small against the position's deviation."""
    _, _, information = gauss_newton(surface, after)
    step = after - before
    return float(step @ information @ step) < STILL**2


def _clear_of(measurements: Measurements, station: Station) -> Station:
    """The station, moved by `MIN_DISTANCE_M` where it would be exactly at a measurement."""
    offset = measurements.positions_m - np.asarray(station.position_m)
    if station.height_m == 0.0 and not offset.any(axis=1).all():
        x, y = station.position_m
        return replace(station, position_m=(x + MIN_DISTANCE_M, y))
    return station
