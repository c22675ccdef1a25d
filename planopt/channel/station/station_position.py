"""Estimate the station's position: both ways of [GM11], and the likelihood over places.

``line`` takes the errors for independent: least squares of the path loss line over the position and
theta. ``joint`` takes them for shadowing and multipath: maximum likelihood over the position, theta
and the covariance, the last by REML at the position in turn. The likelihood has several optima, so
both look at a grid first and climb from the best of its minima with the exact gradient.

With y = Gamma(q) theta + e, e ~ N(0, V), and theta profiled out, minus the logarithm of the
likelihood of position q is

    l(q) = (y - Gamma theta)' V^-1 (y - Gamma theta) / 2
    theta = (Gamma' V^-1 Gamma)^-1 Gamma' V^-1 y

V does not depend on q, so that one factor serves every position, and both the values on a grid and
the Gauss-Newton terms at a place cost a triangular solve each. A prior of n_PL enters as one
further measurement of n_PL.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import lower_factor, solve_lower
from planopt.channel.estimation.covariance_fit import MIN_VARIANCE_DB2
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.estimation.least_squares import least_squares
from planopt.channel.estimation.likelihood_climb import minimise_damped, thinned
from planopt.channel.estimation.reml import MOST_DENSE
from planopt.channel.intervals.censoring import gaussian_sites
from planopt.channel.measurement_covariance import (
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import (
    MIN_DISTANCE_M,
    PRIOR_N_PL,
    PRIOR_N_PL_STD,
    ChannelParameters,
    Station,
    mean_model,
    regressors,
)
from planopt.errors import InputError

DB_PER_NEPER = 10.0 / math.log(10.0)
"""Change of 10 log10 d by that of ln d."""

MIN_N_PL = 1e-3
"""Positions from which the power grows with the distance, or does not fall, are no candidates."""


@dataclass(frozen=True, eq=False)
class StationSurface:
    """Measurements, whitened by the factor of their covariance, at an antenna's height."""

    positions_m: NDArray[np.float64]  # (n, 2)
    height_m: float  # Of the station
    lower: NDArray[np.float64]  # (n, n) L with L L' = V
    whitened_db: NDArray[np.float64]  # (n,) L^-1 y
    has_prior: bool  # Whether n_PL has its prior

    def station(self, position_m: NDArray[np.float64]) -> Station:
        """The station at `position_m` (2,)."""
        return Station((float(position_m[0]), float(position_m[1])), self.height_m)


@dataclass(frozen=True)
class Losses:
    """The loss of positions of the station."""

    loss: NDArray[np.float64]  # (m,) l(q); inf where n_PL is less than `MIN_N_PL`
    theta: NDArray[np.float64]  # (m, 2) theta profiled out there


def gaussian_covariance_db2(
    measurements: Measurements, parameters: ChannelParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Measurements as Gaussian ones: values (n,) in dBm and their covariance V (n, n).

    Censored and rounded ones are replaced by the sites of
    :func:`planopt.channel.intervals.censoring.gaussian_sites`.
    """
    sites = gaussian_sites(parameters, measurements)
    covariance = own_covariance_db2(measured_origins(measurements, parameters), parameters)
    noise = sites.noise_variance_db2 + measured_path_loss_variance_db2(measurements, parameters)
    covariance.flat[:: len(covariance) + 1] += noise
    return sites.values_db, covariance


def station_surface(
    measurements: Measurements, parameters: ChannelParameters, *, has_prior: bool
) -> StationSurface:
    """The surface under the covariance, and the sites about the mean, of `parameters`."""
    values, covariance = gaussian_covariance_db2(measurements, parameters)
    lower = lower_factor(covariance)
    return StationSurface(
        measurements.positions_m,
        parameters.station.height_m,
        lower,
        solve_lower(lower, values),
        has_prior,
    )


def losses(surface: StationSurface, places_m: NDArray[np.float64]) -> Losses:
    """Values at `places_m` (m, 2)."""
    dx = surface.positions_m[:, None, 0] - places_m[:, 0]
    dy = surface.positions_m[:, None, 1] - places_m[:, 1]
    square = np.maximum(dx**2 + dy**2 + surface.height_m**2, MIN_DISTANCE_M**2)
    slope = solve_lower(surface.lower, (-0.5 * DB_PER_NEPER) * np.log(square))
    ones = solve_lower(surface.lower, np.ones(len(slope)))
    weight = float(ones @ ones)
    mean_slope, mean_power = ones @ slope / weight, float(ones @ surface.whitened_db) / weight
    slope -= ones[:, None] * mean_slope
    power = surface.whitened_db - ones * mean_power
    precision = PRIOR_N_PL_STD**-2 if surface.has_prior else 0.0
    information = np.einsum("ij,ij->j", slope, slope) + precision
    score = power @ slope + precision * PRIOR_N_PL
    n_pl = score / np.maximum(information, np.finfo(np.float64).tiny)
    loss = 0.5 * (float(power @ power) + precision * PRIOR_N_PL**2 - score * n_pl)
    return Losses(
        np.where(n_pl >= MIN_N_PL, loss, np.inf),
        np.column_stack([mean_power - mean_slope * n_pl, n_pl]),
    )


def mean_jacobian(
    positions_m: NDArray[np.float64], station: Station, n_pl: float
) -> NDArray[np.float64]:
    """Derivatives of the mean power by K_PL, n_PL and the station's x and y; ``(n, 4)``.

    By the position it is ``10 n_PL / ln 10 (p - q) / d^2`` for a measurement at p.
    """
    offset = positions_m - np.asarray(station.position_m)
    square = (offset**2).sum(axis=1) + station.height_m**2
    # Where the distance is held at its least value the mean does not move.
    factor = np.where(
        square > MIN_DISTANCE_M**2, n_pl * DB_PER_NEPER / np.maximum(square, 1e-12), 0
    )
    return np.column_stack([regressors(positions_m, station), offset * factor[:, None]])


def gauss_newton(
    surface: StationSurface, position_m: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Value, gradient (2,) and Gauss-Newton curvature (2, 2) of l at a position (2,).

    The gradient is exact. The curvature is the expected (Fisher) information of the position with
    theta unknown: its inverse is the position's covariance where l is a paraboloid.
    """
    station = surface.station(position_m)
    found = losses(surface, np.asarray(position_m, dtype=np.float64)[None])
    theta = found.theta[0]
    whitened = solve_lower(
        surface.lower, mean_jacobian(surface.positions_m, station, float(theta[1]))
    )
    residual = surface.whitened_db - whitened[:, :2] @ theta
    gradient = -whitened[:, 2:].T @ residual
    information = whitened.T @ whitened
    if surface.has_prior:
        information[1, 1] += PRIOR_N_PL_STD**-2
    by_theta = np.linalg.pinv(information[:2, :2], hermitian=True)
    cross = information[:2, 2:]
    return float(found.loss[0]), gradient, information[2:, 2:] - cross.T @ by_theta @ cross


GRID = 41
"""Positions along each side of the grid."""

GRID_MARGIN = 0.5
"""The grid reaches beyond the measurements by this share of their extent."""

MARGIN = 2.0
"""The climbs may go so far: from there all distances are the same within a factor of 2."""

STARTS = 4
"""Minima of the grid that are climbed from."""

TOLERANCE = 1e-6
"""A climb ends when a step promises less than this, in units of log-likelihood."""


@dataclass(frozen=True)
class Box:
    """The box that the station is searched in."""

    low_m: NDArray[np.float64]  # (2,) corners
    high_m: NDArray[np.float64]

    def grid_m(self, number: int) -> NDArray[np.float64]:
        """A lattice of `number` x `number` positions, rows along x; ``(number^2, 2)``."""
        iy, ix = np.divmod(np.arange(number**2), number)
        share = np.column_stack([ix, iy]) / (number - 1)
        return self.low_m + share * (self.high_m - self.low_m)


def box_about(positions_m: NDArray[np.float64], margin: float) -> Box:
    """The box about measured positions (n, 2), and beyond by `margin` times their extent."""
    low, high = positions_m.min(axis=0), positions_m.max(axis=0)
    reach = margin * extent_m(positions_m)
    return Box(low - reach, high + reach)


def extent_m(positions_m: NDArray[np.float64]) -> float:
    """Diagonal of the bounding box of positions (n, 2)."""
    return float(np.hypot(*np.ptp(positions_m, axis=0)))


def grid_starts(surface: StationSurface) -> list[NDArray[np.float64]]:
    """The best minima of the likelihood on the grid."""
    grid = box_about(surface.positions_m, GRID_MARGIN).grid_m(GRID)
    loss = losses(surface, grid).loss.reshape(GRID, GRID)
    if not np.isfinite(loss).any():
        raise InputError(
            "power grows with the distance from every position tried",
            remedy="give the station's position",
        )
    padded = np.pad(loss, 1, constant_values=np.inf)
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).min(axis=(2, 3))
    found = np.flatnonzero((loss <= around) & np.isfinite(loss))
    best = found[np.argsort(loss.flat[found])][:STARTS]
    return list(grid[best])


def best_climb(surface: StationSurface, starts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The best optimum reached from `starts`."""
    climbs = [climb(surface, start) for start in starts]
    return min(climbs, key=lambda climb: climb[0])[1]


def climb(surface: StationSurface, start: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """The loss reached from `start`, and where."""
    # Lengths in tenths of the extent, so that the minimiser's longest step is of the box's size.
    unit = 0.1 * extent_m(surface.positions_m)
    box = box_about(surface.positions_m, MARGIN)

    def objective(
        moved: NDArray[np.float64],
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        loss, gradient, curvature = gauss_newton(surface, start + unit * moved)
        return loss, unit * gradient, unit**2 * curvature

    loss, moved = minimise_damped(
        objective,
        np.zeros(2),
        (box.low_m - start) / unit,
        (box.high_m - start) / unit,
        TOLERANCE,
    )
    return loss, start + unit * moved


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
    """The most likely position."""
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
    fitted = fit_channel(measurements, station, forgetting_s=forgetting_s).parameters
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
    """Return whether the move is small against the position's deviation."""
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
