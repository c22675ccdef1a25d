"""The distance until connected with exact gradient and Hessian of its filtered form, for solvers.

:mod:`planopt.objectives.passage_programme` says what is filtered; cusps are rounded as in
:mod:`planopt.objectives.path_loss_learning`, and only the local channel's measurements are
used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.nearest.local_channel import LocalChannel
from planopt.channel.places import require_places
from planopt.objectives.batch_derivatives import (
    BatchDerivatives,
    PathDerivatives,
    add_own_blocks,
    batch_derivatives,
    curvature_of,
)
from planopt.objectives.passage_programme import passage_programme, slopes_and_bends
from planopt.objectives.terms.motion_energy import legs_curvature
from planopt.objectives.until_connected import NOT_TRIED_DB, WAITING, Search, counted_legs_m
from planopt.targets.rounding import Derivatives, rounded_length


def charged_distance_derivatives(
    channels: Sequence[LocalChannel],
    path_m: NDArray[np.float64],  # (h, 2)
    settings: Search,
    width_m: float,
    beyond: Derivatives | None = None,
    tried: NDArray[np.bool_] | None = None,
) -> PathDerivatives:
    """:func:`planopt.objectives.until_connected.charged_distance_m`, filtered, with derivatives."""
    places = require_places(path_m)
    steps = len(places)
    stations = [_station(channel, places) for channel in channels]
    legs = rounded_length(np.diff(np.vstack([settings.start_m, places]), axis=0), width_m)
    if settings.step_m is not None:
        driven = 1.0 - WAITING
        counted = counted_legs_m(legs.value, settings.step_m)
        legs = Derivatives(counted, driven * legs.gradient, driven * legs.hessian)

    # What each coordinate changes: rows of z = (mean, covariance, legs), columns of coordinates.
    k = np.arange(steps)
    by_leg = np.zeros((steps, steps, 2))
    by_leg[k, k] = legs.gradient
    by_leg[k[1:], k[:-1]] = -legs.gradient[1:]
    by_beyond = np.zeros((1, steps, 2))
    if beyond is None:
        beyond = Derivatives(np.array([settings.beyond_m]), np.zeros((1, 2)), np.zeros((1, 3)))
    by_beyond[0, -1] = beyond.gradient[0]
    ways = np.concatenate([*(station.ways for station in stations), by_leg, by_beyond])
    ways = ways.reshape(-1, 2 * steps)

    missing_db = 0.0 if tried is None else np.where(tried, 0.0, NOT_TRIED_DB)
    z = np.concatenate(
        [
            part
            for station, threshold in zip(stations, settings.thresholds_dbm, strict=True)
            for part in (
                station.mean.value - threshold - missing_db,
                station.batch.covariance.ravel(),
            )
        ]
        + [legs.value, beyond.value]
    )
    programme = passage_programme(steps, len(stations))
    value, gradient, bends = slopes_and_bends(programme, z, ways)
    hessian = ways.T @ bends
    size = steps * (steps + 1)
    for number, station in enumerate(stations):
        own = gradient[number * size : (number + 1) * size]
        by_s = own[steps:].reshape(steps, steps)
        hessian += curvature_of(station.batch, 0.5 * (by_s + by_s.T))
        add_own_blocks(hessian, own[:steps, None] * station.mean.hessian)
    hessian += legs_curvature(legs, gradient[-steps - 1 : -1])
    xx, xy, yy = gradient[-1] * beyond.hessian[0]
    hessian[-2:, -2:] += [[xx, xy], [xy, yy]]
    return PathDerivatives(value, ways.T @ gradient, 0.5 * (hessian + hessian.T))


@dataclass(frozen=True, eq=False)
class _Station:
    """One station's power along a path: law of the places, and what each coordinate changes.

    `ways` has the rows of mean and covariance, ``(h (h + 1), h, 2)``.
    """

    batch: BatchDerivatives
    mean: Derivatives
    ways: NDArray[np.float64]


def _station(channel: LocalChannel, places_m: NDArray[np.float64]) -> _Station:
    steps = len(places_m)
    batch = batch_derivatives(channel, places_m, universal=True)
    power = batch.phi @ channel.weights
    mean = Derivatives(
        batch.trend.value @ channel.theta + power[:, 0],
        batch.trend.first.reshape(steps, 2, 2) @ channel.theta + power[:, 1:3],
        batch.trend.second @ channel.theta + power[:, 3:],
    )
    k = np.arange(steps)
    by_mean = np.zeros((steps, steps, 2))
    by_mean[k, k] = mean.gradient
    by_covariance = np.zeros((steps, steps, steps, 2))
    first = batch.first.reshape(steps, 2, steps)
    by_covariance[k, :, k] += first.transpose(0, 2, 1)
    by_covariance[:, k, k] += first.transpose(2, 0, 1)
    ways = np.concatenate([by_mean, by_covariance.reshape(-1, steps, 2)])
    return _Station(batch, mean, ways)
