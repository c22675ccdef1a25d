"""Fits of the channel and of an unknown station position (equation 2.12).

``line`` minimises squared residuals over position and theta, ``joint`` maximises the likelihood
over position, theta and covariance. The likelihood has several optima, so both evaluate a grid
first and refine its best minima. The position covariance of ``line`` is the sandwich
A J' W V W J A with A = (J' W J)^-1, J the Jacobian of the mean, W the weights of the line and V the
fitted covariance. That of ``joint`` is the likelihood's second moment about the estimate, over the
positions that a likelihood-ratio test does not reject.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import shapely

from planopt.arrays import Floats
from planopt.channel.cholesky import lower_factor, one_blas_thread, solve_lower
from planopt.channel.estimation.channel_fit import MIN_VARIANCE_DB2, ChannelFit, FitMethod, Loss
from planopt.channel.estimation.fit import fit_channel, poor_words
from planopt.channel.estimation.least_squares import least_squares, require_usable
from planopt.channel.estimation.reml import MOST_DENSE, minimise_damped, thinned
from planopt.channel.gaussian_sites import gaussian_sites
from planopt.channel.measurements import (
    Measurements,
    Table,
    as_measurements,
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
)
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

StationMethod = Literal["line", "joint"]

DB_PER_NEPER = 10.0 / math.log(10.0)  # Derivative of 10 log10 d with respect to ln d
MIN_N_PL = 1e-3  # Minimum n_PL of a candidate position: power must fall with the distance from it
MIN_UNCENSORED = 8
"""Minimum number of uncensored measurements: two coordinates and five parameters are estimated."""
GRID = 41  # Number of positions along each side of the search grid
GRID_MARGIN = 0.5  # Margin of the grid around the measurements, as a share of their extent
MARGIN = 2.0
"""Margin of the refinement in extents; at its edge all distances agree within a factor of 2."""
STARTS = 4  # Number of grid minima used as initial guesses
TOLERANCE = 1e-6  # Refinement ends when a step's predicted gain in log-likelihood is below this
SEARCH_MEASUREMENTS = 300
"""Maximum number of measurements in the search; the last step uses up to `MOST_DENSE`."""
JOINT_ROUNDS, LINE_ROUNDS = 4, 40  # Maximum numbers of alternations for ``joint`` and for ``line``
STILL = 0.1  # Converged when a step is below this share of the position's standard deviation
REJECTED = 6.9
"""Positions whose log-likelihood is lower than the best by more than this are left out: half the
99.9 % quantile of chi-squared with two degrees of freedom. Otherwise the many distant, unlikely
positions would dominate the moments."""
LATTICE = 41  # Number of positions along each side of the lattice for the moments; odd
EDGE_SHARE = 0.05
"""Maximum weight at the edge of the lattice; with more, the position is not determined."""
OTHER_HEIGHTS_M = (4.0, 8.0, 16.0)  # Heights as probable as 0 for a station of unknown height
QUANTILE = 5.99  # 95 % quantile of chi-squared with two degrees of freedom
SINGULAR = 1e12  # Condition number above which an information matrix counts as singular


@one_blas_thread()
def fit_channel_and_station(
    measurements: Measurements | Table,
    method: FitMethod = "map",
    height_m: float | None = 0.0,
    forgetting_s: float = math.inf,
    *,
    station_method: StationMethod = "joint",
    loss: Loss = "squares",
) -> ChannelFit:
    """Estimate the station's position together with the channel.

    Parameters
    ----------
    measurements
        Measurements, at least `MIN_UNCENSORED` of them uncensored and not all on one line (the
        mirrored position would be equally likely).
    method
        Method of the final fit, as in :func:`planopt.channel.fit_channel`.
    height_m
        Height of the station's antenna above the robots'. If None, the position is estimated for
        height 0, and its covariance (of ``joint``) also covers `OTHER_HEIGHTS_M`.
    forgetting_s
        Time scale of the channel, as in :func:`planopt.channel.fit_channel`.
    station_method
        ``joint``: maximum likelihood over position, theta and covariance. ``line``: the position
        with the best least-squares fit of the path loss line. A fixed random subset of
        `MOST_DENSE` measurements is used for the position if there are more.
    loss
        Loss of the final fit, as in :func:`planopt.channel.fit_channel`.

    Returns
    -------
    ChannelFit
        Fit with the estimated station in its parameters, the covariance of its position in
        `station_covariance_m2` and a warning that the position is estimated. The status is at best
        ``weak`` if n_PL is poorly determined or the position is outside the measurements' convex
        hull. Covariance and standard errors of theta include the uncertainty of the position. If
        the measurements do not determine it, its variances and theta's standard errors are
        infinite, the status is ``degenerate``, and theta's covariance is for a known position.

    Raises
    ------
    InputError
        The measurements cannot locate the station, power grows with the distance from every
        candidate position, or the method does not exist.
    """
    measurements = as_measurements(measurements)
    if station_method not in get_args(StationMethod):
        raise InputError(
            f"is {station_method!r}, which is not a method for locating the station",
            key="station_method",
            remedy=f"use {', '.join(get_args(StationMethod))}",
        )
    require_usable(measurements, None)
    measurements = measurements.by_place()
    remedy = "give the station's position"
    exact = measurements.positions_m[~measurements.censored]
    if len(exact) < MIN_UNCENSORED:
        raise InputError(
            f"{len(exact)} uncensored measurements are too few to locate the station", remedy=remedy
        )
    spread = np.linalg.svd(exact - exact.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-3 * spread[0]:
        raise InputError(
            "all measurements are on one straight line: the station may be on either side of it",
            remedy=remedy,
        )
    station = locate(measurements, station_method, height_m or 0.0, forgetting_s)
    found = fit_channel(measurements, station, method, forgetting_s, loss=loss)
    sample = measurements.take(thinned(len(measurements), MOST_DENSE))
    parameters, errors = found.parameters, found.standard_errors
    if station_method == "line":
        covariance = line_covariance_m2(sample, parameters)
    else:
        heights = OTHER_HEIGHTS_M if height_m is None else ()
        covariance = joint_covariance_m2(sample, parameters, heights)
    place = "the station's position ({:.2f}, {:.2f}) m is ".format(*station.position_m)
    if covariance is None:
        return replace(
            found,
            status="degenerate",
            standard_errors={**errors, "k_pl_db": math.inf, "n_pl": math.inf},
            station_covariance_m2=np.diag([math.inf, math.inf]),
            warnings=(place + "not bounded by the measurements", *found.warnings),
        )
    slope = theta_by_position(sample, parameters)
    theta_covariance = found.theta_covariance + slope @ covariance @ slope.T
    k_error, n_error = np.sqrt(np.maximum(np.diag(theta_covariance), 0.0))
    status, remarks = found.status, [place + "estimated, not given"]
    alone, poor = (
        poor_words("n_pl", parameters.n_pl, error) for error in (errors["n_pl"], float(n_error))
    )
    if poor:
        status = "weak" if status == "ok" else status
        remarks.append(poor)
    hull = shapely.MultiPoint(measurements.positions_m).convex_hull
    outside_m = hull.distance(shapely.Point(station.position_m))
    if outside_m > 0.0:
        status = "weak" if status == "ok" else status
        within_m = math.sqrt(QUANTILE * float(np.linalg.eigvalsh(covariance).max()))
        remarks.append(
            f"the station is {outside_m:.3g} m outside the extent of the measurements, and its "
            f"95 % region reaches {within_m:.3g} m from there (measure around it, or give "
            "its position)"
        )
    return replace(
        found,
        status=status,
        theta_covariance=theta_covariance,
        standard_errors={**errors, "k_pl_db": float(k_error), "n_pl": float(n_error)},
        station_covariance_m2=covariance,
        warnings=(*remarks, *(each for each in found.warnings if each != alone)),
    )


@dataclass(frozen=True, eq=False)
class StationSurface:
    """Negative log-likelihood l(q) of the station's position q, stored as whitened measurements."""

    positions_m: Floats  # (n, 2)
    height_m: float  # Antenna height of the station
    lower: Floats  # (n, n) L with L L' = V
    whitened_db: Floats  # (n,) L^-1 y
    has_prior: bool  # True if the prior on n_PL is used

    def station(self, position_m: Floats) -> Station:
        """Return the station at `position_m` (2,)."""
        return Station((float(position_m[0]), float(position_m[1])), self.height_m)

    @property
    def extent_m(self) -> float:
        """Diagonal of the bounding box of the measurements."""
        return float(np.hypot(*np.ptp(self.positions_m, axis=0)))

    def box_m(self, margin: float) -> tuple[Floats, Floats]:
        """Return the corners of the bounding box, enlarged by `margin` extents on each side."""
        low, high = self.positions_m.min(axis=0), self.positions_m.max(axis=0)
        return low - margin * self.extent_m, high + margin * self.extent_m


def station_surface(
    measurements: Measurements, parameters: ChannelParameters, *, has_prior: bool
) -> StationSurface:
    """Return the likelihood surface with covariance and sites from `parameters`."""
    sites = gaussian_sites(parameters, measurements)
    covariance = own_covariance_db2(measured_origins(measurements, parameters), parameters)
    noise = sites.noise_variance_db2 + measured_path_loss_variance_db2(measurements, parameters)
    covariance.flat[:: len(covariance) + 1] += noise
    lower = lower_factor(covariance)
    whitened = solve_lower(lower, sites.values_db)
    height_m = parameters.station.height_m
    return StationSurface(measurements.positions_m, height_m, lower, whitened, has_prior)


def losses(surface: StationSurface, places_m: Floats) -> tuple[Floats, Floats]:
    """Return the loss l (m,) and the best theta (m, 2) for stations at `places_m` (m, 2)."""
    # l is infinite where n_PL is below `MIN_N_PL`.
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
    theta = np.column_stack([mean_power - mean_slope * n_pl, n_pl])
    return np.where(n_pl >= MIN_N_PL, loss, np.inf), theta


def _mean_jacobian(positions_m: Floats, station: Station, n_pl: float) -> Floats:
    """Return the Jacobian (n, 4) of the mean with respect to K_PL, n_PL, x and y."""
    # For a measurement at p the gradient with respect to q is ``10 n_PL / ln 10 (p - q) / d^2``.
    offset = positions_m - np.asarray(station.position_m)
    square = (offset**2).sum(axis=1) + station.height_m**2
    # The mean is constant within the minimum distance.
    factor = np.where(
        square > MIN_DISTANCE_M**2, n_pl * DB_PER_NEPER / np.maximum(square, 1e-12), 0
    )
    return np.column_stack([regressors(positions_m, station), offset * factor[:, None]])


def gauss_newton(surface: StationSurface, position_m: Floats) -> tuple[float, Floats, Floats]:
    """Return the loss l of a station position, its gradient (2,) and approximate Hessian (2, 2)."""
    # The gradient is exact, the curvature the Fisher information with theta unknown.
    station = surface.station(position_m)
    (loss,), (theta,) = losses(surface, np.asarray(position_m, dtype=np.float64)[None])
    jacobian = _mean_jacobian(surface.positions_m, station, float(theta[1]))
    whitened = solve_lower(surface.lower, jacobian)
    residual = surface.whitened_db - whitened[:, :2] @ theta
    gradient = -whitened[:, 2:].T @ residual
    information = whitened.T @ whitened
    if surface.has_prior:
        information[1, 1] += PRIOR_N_PL_STD**-2
    by_theta = np.linalg.pinv(information[:2, :2], hermitian=True)
    cross = information[:2, 2:]
    return float(loss), gradient, information[2:, 2:] - cross.T @ by_theta @ cross


def _grid_starts(surface: StationSurface) -> list[Floats]:
    """Return the best local minima of the loss on a grid of station positions."""
    low, high = surface.box_m(GRID_MARGIN)
    iy, ix = np.divmod(np.arange(GRID**2), GRID)
    grid = low + np.column_stack([ix, iy]) / (GRID - 1) * (high - low)
    loss = losses(surface, grid)[0].reshape(GRID, GRID)
    if not np.isfinite(loss).any():
        raise InputError(
            "the station cannot be located: from every candidate position, power increases "
            "with distance",
            remedy="give the station's position",
        )
    padded = np.pad(loss, 1, constant_values=np.inf)
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).min(axis=(2, 3))
    found = np.flatnonzero((loss <= around) & np.isfinite(loss))
    return list(grid[found[np.argsort(loss.flat[found])][:STARTS]])


def _climbed(surface: StationSurface, starts: list[Floats]) -> Floats:
    """Return the best station position reached from the initial guesses `starts`."""
    # Scaled to tenths of the extent to suit the minimiser's maximum step.
    unit = 0.1 * surface.extent_m
    low, high = surface.box_m(MARGIN)

    def climb(start: Floats) -> tuple[float, Floats]:
        def objective(moved: Floats) -> tuple[float, Floats, Floats]:
            loss, gradient, curvature = gauss_newton(surface, start + unit * moved)
            return loss, unit * gradient, unit**2 * curvature

        ends = (low - start) / unit, (high - start) / unit
        loss, moved = minimise_damped(objective, np.zeros(2), *ends, TOLERANCE)
        return loss, start + unit * moved

    return min((climb(start) for start in starts), key=lambda one: one[0])[1]


def locate(
    measurements: Measurements, station_method: StationMethod, height_m: float, forgetting_s: float
) -> Station:
    """Return the station at its most likely position."""
    sample = measurements.take(thinned(len(measurements), SEARCH_MEASUREMENTS))
    more = measurements.take(thinned(len(measurements), MOST_DENSE))
    # Initial guess: unit weights, with limits as if they were powers.
    x, y = (float(value) for value in measurements.positions_m.mean(axis=0))
    even = ChannelParameters(0.0, 0.0, 0.0, 1.0, 1.0, Station((x, y), height_m))
    first = replace(sample, censored=np.zeros(len(sample), dtype=np.bool_))
    surface = station_surface(first, even, has_prior=False)
    station = surface.station(_climbed(surface, _grid_starts(surface)))
    is_joint = station_method == "joint"
    for _ in range(JOINT_ROUNDS if is_joint else LINE_ROUNDS):
        before = np.asarray(station.position_m)
        if is_joint:
            # Restarting from the grid each time allows a switch to another optimum.
            surface = _joint_surface(sample, station, forgetting_s)
            position = _climbed(surface, [before, *_grid_starts(surface)])
        else:
            surface = _line_surface(more, station)
            position = _climbed(surface, [before])
        station = surface.station(position)
        step, information = position - before, gauss_newton(surface, position)[2]
        if float(step @ information @ step) < STILL**2:
            break
    if is_joint and len(more) > len(sample):
        surface = _joint_surface(more, station, forgetting_s)
        station = surface.station(_climbed(surface, [np.asarray(station.position_m)]))
    return _clear_of(measurements, station)


def _line_surface(measurements: Measurements, station: Station) -> StationSurface:
    """Return the likelihood surface for independent errors with the line's residual variance."""
    model = mean_model(measurements.positions_m, ~measurements.censored, station, True)
    line = least_squares(model, measurements)
    k_pl, n_pl = model.theta(line.coefficients)
    deviation = math.sqrt(max(line.variance_db2, MIN_VARIANCE_DB2))
    parameters = ChannelParameters(k_pl, n_pl, 0.0, 1.0, deviation, station)
    return station_surface(measurements, parameters, has_prior=False)


def _joint_surface(
    measurements: Measurements, station: Station, forgetting_s: float
) -> StationSurface:
    """Return the likelihood surface with the covariance that REML fits for `station`."""
    # The prior on n_PL is used: a farther station with a larger n_PL fits almost equally well.
    station = _clear_of(measurements, station)
    fitted = fit_channel(measurements, station, "reml", forgetting_s).parameters
    return station_surface(measurements, fitted, has_prior=True)


def _clear_of(measurements: Measurements, station: Station) -> Station:
    """Return the station, moved by `MIN_DISTANCE_M` if it coincides with a measurement."""
    offset = measurements.positions_m - np.asarray(station.position_m)
    if station.height_m == 0.0 and not offset.any(axis=1).all():
        x, y = station.position_m
        return replace(station, position_m=(x + MIN_DISTANCE_M, y))
    return station


def line_covariance_m2(measurements: Measurements, parameters: ChannelParameters) -> Floats | None:
    """Return the covariance (2, 2) of a position fitted by ``line``; None if undetermined."""
    line = _line_surface(measurements, parameters.station)
    fitted = station_surface(measurements, parameters, has_prior=False)
    if _is_at_edge(line, parameters.station):
        return None
    whitened = _whitened_jacobian(line, parameters)
    information = whitened.T @ whitened
    # Scaled, so that the condition number does not depend on units.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(np.float64).tiny))
    scaled = information * np.outer(scale, scale)
    if np.linalg.cond(scaled) > SINGULAR:
        return None
    inverse = scale[:, None] * np.asarray(np.linalg.inv(scaled)) * scale
    # W^1/2 V W^1/2 = H H'.
    half = solve_lower(line.lower, np.tril(fitted.lower)).T @ (whitened @ inverse)
    return (half.T @ half)[2:, 2:]


def joint_covariance_m2(
    measurements: Measurements, parameters: ChannelParameters, other_heights_m: Sequence[float] = ()
) -> Floats | None:
    """Return the covariance (2, 2) of a position fitted by ``joint``; None if undetermined."""
    # Moments are sums over a lattice along the principal axes, coarser at larger distances.
    surface = station_surface(measurements, parameters, has_prior=True)
    if _is_at_edge(surface, parameters.station):
        return None
    estimate = np.asarray(parameters.station.position_m)
    eigenvalues, axes = np.linalg.eigh(gauss_newton(surface, estimate)[2])
    scale = 1.0 / np.sqrt(np.maximum(eigenvalues, surface.extent_m**-2))
    share = np.linspace(-1.0, 1.0, LATTICE)
    growth = np.arcsinh(MARGIN * surface.extent_m / scale)
    i, j = np.divmod(np.arange(LATTICE**2), LATTICE)
    shares = np.column_stack([share[i], share[j]])
    area = np.prod(np.cosh(growth * shares), axis=1)
    off = (scale * np.sinh(growth * shares)) @ axes.T
    places = estimate + off
    heights = (surface.height_m, *other_heights_m)
    loss = np.stack([losses(replace(surface, height_m=h), places)[0] for h in heights])
    # The total variance is integrated out: at its fitted value the loss is `freedom`.
    freedom = 0.5 * (len(surface.whitened_db) - 2)
    drop = freedom * np.log1p((loss - loss.min()) / freedom)
    weights = area * np.where(drop < REJECTED, np.exp(-drop), 0.0).sum(axis=0)
    weights /= weights.sum()
    if float(weights[(np.abs(shares) == 1.0).any(axis=1)].sum()) > EDGE_SHARE:
        return None
    return (weights[:, None] * off).T @ off


def theta_by_position(measurements: Measurements, parameters: ChannelParameters) -> Floats:
    """Return the derivative (2, 2) of theta with respect to the station's position."""
    # The position's error is uncorrelated with theta's at the true position.
    surface = station_surface(measurements, parameters, has_prior=False)
    whitened = _whitened_jacobian(surface, parameters)
    information = whitened.T @ whitened
    return -np.linalg.pinv(information[:2, :2], hermitian=True) @ information[:2, 2:]


def _whitened_jacobian(surface: StationSurface, parameters: ChannelParameters) -> Floats:
    """Return :func:`_mean_jacobian` (n, 4) at the estimated station, whitened."""
    jacobian = _mean_jacobian(surface.positions_m, parameters.station, parameters.n_pl)
    return solve_lower(surface.lower, jacobian)


def _is_at_edge(surface: StationSurface, station: Station) -> bool:
    """Return whether the fitted station is on the edge of the search box."""
    low, high = surface.box_m(MARGIN)
    near, position = 1e-6 * surface.extent_m, np.asarray(station.position_m)
    return bool(((position - low < near) | (high - position < near)).any())
