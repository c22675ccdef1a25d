"""The measurements near a path, as numbers for its derivatives: a cost that does not grow.

The places of a path belong together in the information objectives, so that they share one set of
measurements: of those nearest to each place, in turn, until there are enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.mean_model import regressors
from planopt.channel.measurement_covariance import ageing
from planopt.channel.nearest.neighbours import local_precision
from planopt.channel.offsets import offsets_given_theta
from planopt.channel.parameters import ChannelParameters
from planopt.channel.places import require_count, require_places
from planopt.channel.posterior import ChannelPosterior


@dataclass(frozen=True, eq=False)
class LocalChannel:
    """Kriging from m measurements.

    As :class:`planopt.channel.nearest.neighbours.NeighbourModel` has it.

    Attributes
    ----------
    positions_m
        ``(m, 2)`` where they were taken.
    blur_m2
        ``(m,)`` of errors of these positions.
    precision
        ``(m, m)`` U_mm^-1.
    weights
        ``(m,)`` U_mm^-1 y.
    trend
        ``(m, 2)`` A = U_mm^-1 Gamma_m.
    theta, theta_covariance
        ``(2,)`` (K_PL, n_PL) and ``(2, 2)`` M, from all measurements.
    parameters
        The channel's parameters.
    """

    positions_m: NDArray[np.float64]
    blur_m2: NDArray[np.float64]
    precision: NDArray[np.float64]
    weights: NDArray[np.float64]
    trend: NDArray[np.float64]
    theta: NDArray[np.float64]
    theta_covariance: NDArray[np.float64]
    parameters: ChannelParameters


@dataclass(frozen=True, eq=False)
class LocalGrid:
    """Places of a map, as a local channel sees them.

    Attributes
    ----------
    positions_m
        ``(g, 2)``.
    root_weight
        ``(g,)`` square roots of the weights.
    solved
        ``(m, g)`` U_mm^-1 Phi_g.
    trend
        ``(g, 2)`` varphi(g)'.
    """

    positions_m: NDArray[np.float64]
    root_weight: NDArray[np.float64]
    solved: NDArray[np.float64]
    trend: NDArray[np.float64]


def local_channel(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], count: int
) -> LocalChannel:
    """The `count` measurements nearest to `path_m` (h, 2), or all where there are fewer.

    Each place's nearest come first, then each place's second nearest, and so on, so that no place
    is left out for another.

    Raises
    ------
    InputError
        `path_m` is no path, or `count` is below one.
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
