"""The channel near a path, smooth and at a cost that does not grow, for derivatives.

The places of a path belong together in the information objectives, so that they share one set of
measurements: of those nearest to each place, in turn, until there are enough. A joint law needs the
factor of the measurements' covariance, which a posterior of very many does not have; it is then
conditioned anew on those near the places.

exp(-d / beta) has a cusp at d = 0 and log d a pole. As everywhere in planning, distances to a
measurement become ``sqrt(d^2 + eps^2)`` with eps a hundredth of the decorrelation distance, and the
distance to the station ``sqrt(d^2 + MIN_DISTANCE_M^2)``. The kernel is then smaller than the exact
one by at most the share eps / beta = 0.01, at d = 0; at d = 10 eps by a twentieth of that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurement_covariance import ageing, shadow_covariance_db2
from planopt.channel.nearest.nearby import NEIGHBOURS_BEYOND
from planopt.channel.nearest.neighbours import local_precision
from planopt.channel.offsets import offsets_given_theta
from planopt.channel.parameters import MIN_DISTANCE_M, ChannelParameters, Station, regressors
from planopt.channel.places import require_count, require_places
from planopt.channel.posterior import ChannelPosterior, condition
from planopt.targets.rounding import Derivatives, radial


def factored_near(posterior: ChannelPosterior, places_m: NDArray[np.float64]) -> ChannelPosterior:
    """`posterior` where it has a factor, else one that has, for `places_m` (n, 2).

    Each place is conditioned on at least the `NEIGHBOURS_BEYOND` measurements nearest to it; theta
    and its covariance stay those of all. It is a true posterior of less data.
    """
    if posterior.has_factor:
        return posterior
    used = np.unique(posterior.index.nearest(places_m, NEIGHBOURS_BEYOND)[0])
    near = condition(
        posterior.parameters,
        posterior.measurements.take(used),
        theta=posterior.theta_rule,
        exact_limit=len(used),
    )
    return replace(
        near,
        theta=posterior.theta,
        theta_covariance=posterior.theta_covariance,
        now_s=posterior.now_s,
    )


CUSP_ROUNDING = 0.01
"""Rounding of the kernel's cusp as a share of the decorrelation distance."""


def rounded_kernel(
    offset_m: NDArray[np.float64],  # (..., 2)
    parameters: ChannelParameters,
    blur_m2: NDArray[np.float64] | float = 0.0,  # (...) of position errors
) -> Derivatives:
    """xi^2 exp(-r / beta), r = sqrt(|offset|^2 + blur + eps^2), with derivatives by the offset."""
    rows = np.empty((6, *offset_m.shape[:-1]))
    soft_m2 = softened_m2(blur_m2, parameters)
    fill_rounded_kernel(rows, offset_m[..., 0], offset_m[..., 1], parameters, soft_m2)
    inner = tuple(range(1, rows.ndim))
    return Derivatives(rows[0], rows[1:3].transpose(*inner, 0), rows[3:].transpose(*inner, 0))


def softened_m2(
    blur_m2: NDArray[np.float64] | float, parameters: ChannelParameters
) -> NDArray[np.float64] | float:
    """Return what squared distances of the rounded kernel have more than the offsets'."""
    return blur_m2 + (CUSP_ROUNDING * parameters.decorrelation_m) ** 2


def fill_rounded_kernel(
    rows: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    parameters: ChannelParameters,
    soft_m2: NDArray[np.float64] | float,
) -> None:
    """Write the kernel of offsets `x`, `y` (...) and its derivatives x, y, xx, xy, yy.

    `rows` are ``(6, ...)``; a solver asks again and again and keeps them. `soft_m2` is of
    :func:`softened_m2`.
    """
    beta = parameters.decorrelation_m
    value, by_x, by_y, by_xx, by_xy, by_yy = rows
    r = x * x
    r += y * y
    r += soft_m2
    np.sqrt(r, out=r)
    np.multiply(r, -1.0 / beta, out=value)
    np.exp(value, out=value)
    value *= parameters.shadow_std_db**2
    # -1 / (beta r); the slope is its product with the value.
    fall = np.divide(-1.0 / beta, r, out=r)
    slope = value * fall
    # -slope (1 / (beta r) + 1 / r^2)
    bend = fall * (-(beta**2))
    bend += 1.0
    bend *= fall
    bend *= slope
    np.multiply(slope, x, out=by_x)
    np.multiply(slope, y, out=by_y)
    bent = bend * x
    np.multiply(bent, y, out=by_xy)
    bent *= x
    np.add(bent, slope, out=by_xx)
    bend *= y
    bend *= y
    np.add(bend, slope, out=by_yy)


def rounded_log_distance(positions_m: NDArray[np.float64], station: Station) -> Derivatives:
    """-10 log10 sqrt(d^2 + MIN_DISTANCE_M^2) with derivatives by the position (n, 2)."""
    offset = positions_m - np.asarray(station.position_m)
    square = np.einsum("ni,ni->n", offset, offset) + (station.height_m**2 + MIN_DISTANCE_M**2)
    slope = (-10.0 / math.log(10.0)) / square
    return radial(offset, -5.0 * np.log10(square), slope, -2.0 * slope / square)


@dataclass(frozen=True, eq=False)
class LocalChannel:
    """Kriging from m measurements.

    As :class:`planopt.channel.nearest.neighbours.NeighbourModel` has it.
    """

    positions_m: NDArray[np.float64]  # (m, 2) where they were taken
    blur_m2: NDArray[np.float64]  # (m,) of errors of these positions
    precision: NDArray[np.float64]  # (m, m) U_mm^-1
    weights: NDArray[np.float64]  # (m,) U_mm^-1 y
    trend: NDArray[np.float64]  # (m, 2) A = U_mm^-1 Gamma_m
    theta: NDArray[np.float64]  # (2,) (K_PL, n_PL) and (2, 2) M, from all measurements
    theta_covariance: NDArray[np.float64]
    parameters: ChannelParameters  # The channel's parameters


@dataclass(frozen=True, eq=False)
class LocalGrid:
    """Places of a map, as a local channel sees them."""

    positions_m: NDArray[np.float64]  # (g, 2)
    root_weight: NDArray[np.float64]  # (g,) square roots of the weights
    solved: NDArray[np.float64]  # (m, g) U_mm^-1 Phi_g
    trend: NDArray[np.float64]  # (g, 2) varphi(g)'


def local_channel(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], count: int
) -> LocalChannel:
    """The `count` measurements nearest to `path_m` (h, 2), or all where there are fewer.

    Each place's nearest come first, then each place's second nearest, and so on, so that no place
    is left out for another.
    """
    places = require_places(path_m)
    positions = posterior.measurements.positions_m
    there = min(require_count(count, "count"), len(positions))
    chosen, _ = posterior.index.nearest(places, there)
    away = np.linalg.norm(positions[chosen] - places[:, None], axis=2)
    order = np.take_along_axis(chosen, np.argsort(away, axis=1, kind="stable"), axis=1)
    by_rank, first = np.unique(order.T.ravel(), return_index=True)
    used = by_rank[np.argsort(first)][:there]
    precision, weighted = local_precision(posterior, offsets_given_theta(posterior), used[None])
    origins = posterior.origins.at(used)
    if origins.time_s is not None:
        aged = ageing(origins.time_s, posterior.now_s, posterior.parameters)
        precision *= np.outer(aged, aged)
        weighted *= aged[:, None]
    return LocalChannel(
        origins.positions_m,
        np.zeros(there) if origins.blur_m2 is None else origins.blur_m2,
        precision[0],
        np.ascontiguousarray(weighted[0, :, 0]),
        np.ascontiguousarray(weighted[0, :, 1:]),
        posterior.theta,
        posterior.theta_covariance,
        posterior.parameters,
    )


def local_grid(
    channel: LocalChannel, grid_m: NDArray[np.float64], weight: NDArray[np.float64]
) -> LocalGrid:
    """Prepare a map's places ``(g, 2)`` of weights ``(g,)`` >= 0; once for a channel."""
    phi = shadow_covariance_db2(
        channel.positions_m, grid_m, channel.parameters, channel.blur_m2[:, None]
    )
    return LocalGrid(
        grid_m,
        np.sqrt(weight),
        channel.precision @ phi,
        regressors(grid_m, channel.parameters.station) - phi.T @ channel.trend,
    )
