"""Fit the channel when the station's position is not known (equation 2.12).

The position is found by :mod:`planopt.channel.station.station_position`, the channel is fitted with
the station there, and the position's uncertainty is carried into theta's.

How well an estimated station position is known, and what that adds to the doubt in theta.

For the line, whose estimate is linear in the errors to first order, the covariance is the sandwich

    A J' W V W J A,    A = (J' W J)^-1,

with J the derivatives of the mean by (K_PL, n_PL, x, y), W the weights of the line and V the fitted
covariance of the measurements: A alone takes correlated errors for independent ones, and is several
times too small.

For the joint estimate the mean shares no information with xi, beta and omega, so to first order its
covariance is the inverse of the expected (Fisher) information J' V^-1 J. Where the errors are not
small against the distance to the nearest measurements the likelihood is no paraboloid, and that
inverse is too small. What is reported is the likelihood's second moment about the estimate, over
the positions that a likelihood-ratio test does not reject, the total variance integrated out as in
:mod:`planopt.channel.parameter_uncertainty`. On a paraboloid the two are the same but for 1 %.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import solve_lower
from planopt.channel.estimation.channel_fit import ChannelFit, FitMethod, Loss
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.estimation.identifiability import require_usable
from planopt.channel.estimation.likelihood_climb import thinned
from planopt.channel.estimation.reml import MOST_DENSE
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters
from planopt.channel.station.station_position import (
    MARGIN,
    StationMethod,
    StationSurface,
    box_about,
    extent_m,
    gauss_newton,
    line_surface,
    locate,
    losses,
    mean_jacobian,
    station_surface,
)
from planopt.errors import InputError

REJECTED = 6.9
"""Positions less likely than the best by this many units of log-likelihood are left out: half the
99.9 % point of chi-squared with two degrees of freedom. Far positions, each unlikely, would
outweigh the rest by their number."""

LATTICE = 41
"""Positions along each side of the lattice that moments are summed over; odd."""

EDGE_SHARE = 0.05
"""More weight than this at the edge of the search: the measurements do not bound the position."""

SINGULAR = 1e12
"""Condition beyond which an information counts as singular."""


def line_covariance_m2(
    measurements: Measurements, parameters: ChannelParameters
) -> NDArray[np.float64] | None:
    """The sandwich for the line's position; ``(2, 2)``, or None where it is not determined."""
    if _at_edge(measurements, parameters):
        return None
    line = line_surface(measurements, parameters.station)
    fitted = station_surface(measurements, parameters, has_prior=False)
    whitened = solve_lower(line.lower, _jacobian(measurements, parameters))
    inverse = _inverse(whitened.T @ whitened)
    if inverse is None:
        return None
    # W^1/2 V W^1/2 = H H'.
    half = solve_lower(line.lower, np.tril(fitted.lower)).T @ (whitened @ inverse)
    return (half.T @ half)[2:, 2:]


def joint_covariance_m2(
    measurements: Measurements, parameters: ChannelParameters
) -> NDArray[np.float64] | None:
    """The likelihood's moments about the joint estimate; ``(2, 2)``, or None as for the line."""
    if _at_edge(measurements, parameters):
        return None
    surface = station_surface(measurements, parameters, has_prior=True)
    estimate = np.asarray(parameters.station.position_m)
    off, weights, at_edge = _likely(surface, estimate)
    if float(weights[at_edge].sum()) > EDGE_SHARE:
        return None
    return (weights[:, None] * off).T @ off


def fisher_information(
    measurements: Measurements, parameters: ChannelParameters
) -> NDArray[np.float64]:
    """Expected information J' V^-1 J of (K_PL, n_PL, x, y) at `parameters`; ``(4, 4)``."""
    surface = station_surface(measurements, parameters, has_prior=False)
    whitened = solve_lower(surface.lower, _jacobian(measurements, parameters))
    return whitened.T @ whitened


def theta_by_position(
    measurements: Measurements, parameters: ChannelParameters
) -> NDArray[np.float64]:
    """Derivatives (2, 2) of the generalised least squares theta by the station's x and y.

    With S the position's covariance, theta's grows by B S B': an estimate of the position that does
    not depend on theta is not correlated with theta at the true position.
    """
    information = fisher_information(measurements, parameters)
    return -np.linalg.pinv(information[:2, :2], hermitian=True) @ information[:2, 2:]


def _jacobian(measurements: Measurements, parameters: ChannelParameters) -> NDArray[np.float64]:
    """J at the estimate; ``(n, 4)``."""
    return mean_jacobian(measurements.positions_m, parameters.station, parameters.n_pl)


def _inverse(information: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The inverse, or None where there is none; scaled, so that units do not matter."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(np.float64).tiny))
    scaled = information * np.outer(scale, scale)
    if np.linalg.cond(scaled) > SINGULAR:
        return None
    return scale[:, None] * np.asarray(np.linalg.inv(scaled)) * scale


def _at_edge(measurements: Measurements, parameters: ChannelParameters) -> bool:
    """Return whether the search ended at its edge."""
    positions = measurements.positions_m
    box, near = box_about(positions, MARGIN), 1e-6 * extent_m(positions)
    station = np.asarray(parameters.station.position_m)
    return bool(((station - box.low_m < near) | (box.high_m - station < near)).any())


def _likely(
    surface: StationSurface, estimate_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Positions about the estimate, their weights, and which are at the edge of the search.

    They stand on a lattice along the axes of the information, as far as `MARGIN` extents; the
    spacing grows from a fraction of the deviation there in proportion to the distance.
    """
    # Shapes: returns (m, 2).
    extent = extent_m(surface.positions_m)
    eigenvalues, axes = np.linalg.eigh(gauss_newton(surface, estimate_m)[2])
    scale = 1.0 / np.sqrt(np.maximum(eigenvalues, extent**-2))
    share = np.linspace(-1.0, 1.0, LATTICE)[:, None]
    growth = np.arcsinh(MARGIN * extent / scale)
    along = scale * np.sinh(growth * share)
    area = np.prod(_pairs(np.cosh(growth * share)), axis=1)
    off = _pairs(along) @ axes.T
    loss = losses(surface, estimate_m + off).loss
    # The middle of the lattice is the estimate. Student's t: at the fitted total variance its loss
    # is half the freedom.
    freedom = 0.5 * (len(surface.whitened_db) - 2)
    drop = freedom * np.log1p(np.maximum(loss - loss[len(loss) // 2], 0.0) / freedom)
    kept = drop < REJECTED
    weights = area[kept] * np.exp(-drop[kept])
    at_edge = (np.abs(_pairs(np.repeat(share, 2, axis=1))) == 1.0).any(axis=1)
    return off[kept], weights / weights.sum(), at_edge[kept]


def _pairs(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return all pairs of values of the first and the second of `columns` (k, 2); (k^2, 2)."""
    count = len(columns)
    return np.column_stack([np.repeat(columns[:, 0], count), np.tile(columns[:, 1], count)])


MIN_UNCENSORED = 8
"""Two coordinates and five parameters are wanted."""


@one_blas_thread()
def fit_channel_and_station(
    measurements: Measurements | Table,
    method: FitMethod = "reml",
    height_m: float = 0.0,
    forgetting_s: float = math.inf,
    *,
    station_method: StationMethod = "joint",
    loss: Loss = "squares",
) -> ChannelFit:
    """Estimate the station's position with the channel.

    Parameters
    ----------
    measurements
        At least `MIN_UNCENSORED` uncensored ones, not on one line (from a line the two sides
        cannot be told apart).
    method
        Of the final fit, as in :func:`planopt.channel.estimation.fit.fit_channel`.
    height_m
        Height of the station's antenna above the robots'; not estimated.
    forgetting_s
        As in :func:`planopt.channel.estimation.fit.fit_channel`.
    station_method
        ``joint``: maximum likelihood over position, theta and covariance. ``line``: the position
        from which the path loss line fits best. Of more than `MOST_DENSE` a fixed draw
        serves for the position.
    loss
        Of the final fit, as in :func:`planopt.channel.estimation.fit.fit_channel`.

    Returns
    -------
    ChannelFit
        With the estimated station in its parameters, its covariance in `station_covariance_m2` and
        a warning that says so. Covariance and standard errors of theta count its uncertainty. Where
        the measurements do not bound the position, its variances and the standard errors of theta
        are infinite, the status is ``degenerate``, and the covariance of theta takes the position
        as exact.

    Raises
    ------
    InputError
        The measurements cannot tell where the station is; or the power grows with the distance
        from every position tried; or there is no such way.
    """
    measurements = as_measurements(measurements)
    if station_method not in get_args(StationMethod):
        raise InputError(
            f"{station_method!r} is no way to find the station",
            key="station_method",
            remedy=f"use {', '.join(get_args(StationMethod))}",
        )
    require_usable(measurements, None)
    measurements = measurements.by_place()
    _require_locating(measurements)
    station = locate(measurements, station_method, height_m, forgetting_s)
    found = fit_channel(measurements, station, method, forgetting_s, loss=loss)
    sample = measurements.take(thinned(len(measurements), MOST_DENSE))
    doubt = line_covariance_m2 if station_method == "line" else joint_covariance_m2
    covariance = doubt(sample, found.parameters)
    x, y = station.position_m
    if covariance is None:
        return _undetermined(
            found, f"the station's position ({x:.2f}, {y:.2f}) m is not bounded by the measurements"
        )
    slope = theta_by_position(sample, found.parameters)
    return _with_station(
        found,
        covariance,
        found.theta_covariance + slope @ covariance @ slope.T,
        f"the station's position ({x:.2f}, {y:.2f}) m is estimated, not given",
    )


def _with_station(
    found: ChannelFit,
    covariance_m2: NDArray[np.float64],
    theta_covariance: NDArray[np.float64],
    warning: str,
) -> ChannelFit:
    """The fit with the doubt in its station."""
    k_error, n_error = np.sqrt(np.maximum(np.diag(theta_covariance), 0.0))
    errors = {**found.standard_errors, "k_pl_db": float(k_error), "n_pl": float(n_error)}
    return replace(
        found,
        theta_covariance=theta_covariance,
        standard_errors=errors,
        station_covariance_m2=covariance_m2,
        warnings=(warning, *found.warnings),
    )


def _undetermined(found: ChannelFit, warning: str) -> ChannelFit:
    """The fit where the station might be anywhere, as far as the search went."""
    return replace(
        found,
        status="degenerate",
        standard_errors={**found.standard_errors, "k_pl_db": math.inf, "n_pl": math.inf},
        station_covariance_m2=np.diag([math.inf, math.inf]),
        warnings=(warning, *found.warnings),
    )


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
