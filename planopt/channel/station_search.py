"""Fit the channel when the station's position is not known (seed, footnote 2: joint estimation).

A coarse grid of positions is ranked by the least-squares line; from the best of them the
likelihood is climbed in turn over the covariance (by REML at that position) and over the position
(at that covariance, theta profiled out, n_PL held to its prior).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.fit import ChannelFit, FitMethod, fit_channel
from planopt.channel.identifiability import require_usable
from planopt.channel.mean_model import PRIOR_N_PL, PRIOR_N_PL_STD, mean_model
from planopt.channel.measurements import Measurements
from planopt.channel.minimise import minimise_from_simplex
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import Station
from planopt.channel.path_loss import MIN_DISTANCE_M, regressors
from planopt.channel.reml import thinned
from planopt.channel.restricted_likelihood import evaluate, likelihood_data
from planopt.errors import InputError

GRID = 41
"""Positions along each side of the grid."""

MARGIN = 0.5
"""The grid reaches beyond the measurements by this share of their extent."""

SEARCH_MEASUREMENTS = 300
"""The search uses at most this many measurements; the final fit uses all."""

ROUNDS = 2
"""Alternations between covariance and position."""

STARTS = 2
"""Grid positions that are followed."""

MIN_UNCENSORED = 8
"""Two coordinates and five parameters are wanted."""

Position = tuple[float, float]


@one_blas_thread()
def fit_channel_and_station(
    measurements: Measurements, method: FitMethod = "reml", height_m: float = 0.0
) -> ChannelFit:
    """Estimate the station's position with the channel.

    Parameters
    ----------
    measurements
        At least `MIN_UNCENSORED` uncensored ones, not on one line (from a line the two sides
        cannot be told apart).
    method
        Of the final fit, as in :func:`planopt.channel.fit.fit_channel`.
    height_m
        Height of the station's antenna above the robots'; not estimated.

    Returns
    -------
    ChannelFit
        With the estimated station in its parameters, and a warning that says so. Its standard
        errors take that position as exact.

    Raises
    ------
    InputError
        The measurements cannot tell where the station is, or the power grows with the distance
        from every position tried.
    """
    require_usable(measurements, None)
    _require_locating(measurements)
    rows = thinned(len(measurements), SEARCH_MEASUREMENTS)
    sample = measurements.take(rows)
    climbs = [_climb(sample, start, height_m) for start in _grid_starts(sample, height_m)]
    _, position = min(climbs)
    station = _clear_of(measurements, Station(position, height_m))
    found = fit_channel(measurements, station, method)
    x, y = station.position_m
    warning = f"the station's position ({x:.1f}, {y:.1f}) m is estimated, not given"
    return replace(found, warnings=(warning, *found.warnings))


def _require_locating(measurements: Measurements) -> None:
    """Refuse measurements that are too few, or on one line."""
    remedy = "give the station's position"
    exact = measurements.positions_m[~measurements.censored]
    if len(exact) < MIN_UNCENSORED:
        raise InputError(
            f"{len(exact)} uncensored measurements cannot tell where the station is", remedy=remedy
        )
    spread = np.linalg.svd(exact - exact.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-3 * spread[0]:
        raise InputError(
            "all measurements are on one line: the station may be on either side", remedy=remedy
        )


def _grid_starts(measurements: Measurements, height_m: float) -> list[Position]:
    """The best grid positions by the residual of the least-squares line, far from each other."""
    low_x, low_y = (float(v) for v in measurements.positions_m.min(axis=0))
    high_x, high_y = (float(v) for v in measurements.positions_m.max(axis=0))
    reach = MARGIN * math.hypot(high_x - low_x, high_y - low_y)
    xs = np.linspace(low_x - reach, high_x + reach, GRID)
    ys = np.linspace(low_y - reach, high_y + reach, GRID)
    power = measurements.power_dbm - measurements.power_dbm.mean()
    losses = np.full((GRID, GRID), np.inf)
    for iy, y in enumerate(ys):
        for ix, x in enumerate(xs):
            station = Station((float(x), float(y)), height_m)
            gamma = regressors(measurements.positions_m, station)[:, 1]
            gamma = gamma - gamma.mean()
            slope = float(gamma @ power) / max(float(gamma @ gamma), 1e-300)
            if slope > 0.0:
                losses[iy, ix] = ((power - slope * gamma) ** 2).sum()
    starts: list[Position] = []
    while len(starts) < STARTS and np.isfinite(losses).any():
        iy, ix = (int(i) for i in np.unravel_index(np.argmin(losses), losses.shape))
        starts.append((float(xs[ix]), float(ys[iy])))
        # The next start must be another basin, not the neighbouring cell.
        around = GRID // 8
        losses[max(iy - around, 0) : iy + around + 1, max(ix - around, 0) : ix + around + 1] = (
            np.inf
        )
    if not starts:
        raise InputError(
            "power grows with the distance from every position tried",
            remedy="give the station's position",
        )
    return starts


def _climb(measurements: Measurements, start: Position, height_m: float) -> tuple[float, Position]:
    """Alternate between covariance and position; the loss reached, and where."""
    position, value = start, np.inf
    size = float(np.ptp(measurements.positions_m, axis=0).max()) / GRID
    for _ in range(ROUNDS):
        station = _clear_of(measurements, Station(position, height_m))
        loss = _position_loss(measurements, station)
        simplex = np.asarray(station.position_m) + size * np.array([[0, 0], [1, 0], [0, 1.0]])
        value, best = minimise_from_simplex(loss, simplex, size / 50.0)
        position = float(best[0]), float(best[1])
    return value, position


def _position_loss(
    measurements: Measurements, station: Station
) -> Callable[[NDArray[np.float64]], float]:
    """Minus the log-likelihood of a position, at the covariance fitted for `station`.

    With the prior of n_PL, as where n_PL is not identifiable.
    """
    parameters = fit_channel(measurements, station).parameters
    covariance = (
        parameters.shadow_std_db**2,
        parameters.multipath_std_db**2,
        parameters.decorrelation_m,
    )
    exact = ~measurements.censored

    def loss(xy: NDArray[np.float64]) -> float:
        there = Station((float(xy[0]), float(xy[1])), station.height_m)
        model = mean_model(measurements.positions_m, exact, there, n_pl_identifiable=True)
        at = evaluate(likelihood_data(model, measurements), covariance)
        # The restricted likelihood compares covariances under one design. Between designs the
        # profiled one compares, which lacks the term -log |G' V^-1 G| / 2.
        profiled = at.log_likelihood - 0.5 * float(np.linalg.slogdet(at.coefficient_covariance)[1])
        # From outside, a station farther off with a larger exponent looks much the same.
        surprise = (float(at.coefficients[1]) - PRIOR_N_PL) / PRIOR_N_PL_STD
        return 0.5 * surprise**2 - profiled

    return loss


def _clear_of(measurements: Measurements, station: Station) -> Station:
    """The station, moved by `MIN_DISTANCE_M` where it would be exactly at a measurement."""
    offset = measurements.positions_m - np.asarray(station.position_m)
    if station.height_m == 0.0 and not offset.any(axis=1).all():
        x, y = station.position_m
        return replace(station, position_m=(x + MIN_DISTANCE_M, y))
    return station
