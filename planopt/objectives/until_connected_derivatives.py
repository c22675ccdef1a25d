"""The distance until connected with exact gradient and Hessian of its filtered form, for solvers.

:mod:`planopt.objectives.passage_programme` says what is filtered; cusps are rounded as in
:mod:`planopt.objectives.information_derivatives`, and only the local channel's measurements are
used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.places import require_places
from planopt.objectives.batch_derivatives import (
    PathDerivatives,
    add_own_blocks,
    batch_derivatives,
    curvature_of,
)
from planopt.objectives.local_channel import LocalChannel
from planopt.objectives.motion_derivatives import legs_curvature
from planopt.objectives.passage_programme import passage_programme, slopes_and_bends
from planopt.objectives.until_connected import Search
from planopt.targets.rounding import rounded_length


def charged_distance_derivatives(
    channel: LocalChannel, path_m: NDArray[np.float64], settings: Search, width_m: float
) -> PathDerivatives:
    """:func:`planopt.objectives.until_connected.charged_distance_m`, filtered, with derivatives.

    Parameters
    ----------
    channel
        The measurements near the path.
    path_m
        ``(h, 2)``.
    settings
        Start and threshold.
    width_m
        Legs are rounded within this of zero.
    """
    places = require_places(path_m)
    steps = len(places)
    batch = batch_derivatives(channel, places, universal=True)
    power = batch.phi @ channel.weights
    mean = batch.trend.value @ channel.theta + power[:, 0]
    slope = batch.trend.first.reshape(steps, 2, 2) @ channel.theta + power[:, 1:3]
    bend = batch.trend.second @ channel.theta + power[:, 3:]
    legs = rounded_length(np.diff(np.vstack([settings.start_m, places]), axis=0), width_m)

    # What each coordinate changes: rows of z = (mean, covariance, legs), columns of coordinates.
    k = np.arange(steps)
    by_mean, by_leg = np.zeros((2, steps, steps, 2))
    by_mean[k, k] = slope
    by_leg[k, k] = legs.gradient
    by_leg[k[1:], k[:-1]] = -legs.gradient[1:]
    by_covariance = np.zeros((steps, steps, steps, 2))
    first = batch.first.reshape(steps, 2, steps)
    by_covariance[k, :, k] += first.transpose(0, 2, 1)
    by_covariance[:, k, k] += first.transpose(2, 0, 1)
    ways = np.concatenate([by_mean, by_covariance.reshape(-1, steps, 2), by_leg])
    ways = ways.reshape(-1, 2 * steps)

    z = np.concatenate([mean - settings.threshold_dbm, batch.covariance.ravel(), legs.value])
    value, gradient, bends = slopes_and_bends(passage_programme(steps), z, settings.beyond_m, ways)
    by_s = gradient[steps:-steps].reshape(steps, steps)
    hessian = ways.T @ bends + curvature_of(batch, 0.5 * (by_s + by_s.T))
    add_own_blocks(hessian, gradient[:steps, None] * bend)
    hessian += legs_curvature(legs, gradient[-steps:])
    return PathDerivatives(value, ways.T @ gradient, 0.5 * (hessian + hessian.T))
