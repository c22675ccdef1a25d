# pyright: basic
"""The distance until connected with exact gradient and Hessian of its filtered form, for solvers.

The formula is that of :func:`planopt.objectives.until_connected.filtered_failing` (equation 4.15).
CasADi differentiates it by the moments of the path, whose derivatives are those of
:mod:`planopt.objectives.path_derivatives`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.channel.local_channel import LocalChannel
from planopt.objectives.path_derivatives import (
    LocalPath,
    PathDerivatives,
    add_own_blocks,
    by_lengths,
    length_jacobian,
)
from planopt.objectives.until_connected import (
    LEAST_SCORE,
    NOT_TRIED_DB,
    WAITING,
    Search,
    counted_legs_m,
)
from planopt.targets.rounding import Derivatives, rounded_length


@dataclass(frozen=True)
class PassageProgramme:
    """CasADi functions of z, flat.

    z = (mean above threshold (h,), covariance (h, h)) for each station in turn, then legs (h,) and
    the cost of ending without connection. Stations are independent: their chances multiply.
    """

    value: Any  # Of z: the distance charged
    gradient: Any  # The same by z, of the covariance by its lower triangle only
    along: Any  # Of z and a direction: how the gradient changes along it


@cache
def passage_programme(steps: int, stations: int = 1) -> PassageProgramme:
    """Build the functions for a path of h = `steps` places; kept for each number."""
    size = steps * (steps + 1)
    z = ca.SX.sym("z", stations * size + steps + 1)
    each = [_failing(z[own * size : (own + 1) * size], steps) for own in range(stations)]
    legs = z[stations * size :]  # and beyond, the last
    distance = legs[0]
    for k in range(steps):
        failing = math.prod((own[k] for own in each[1:]), start=each[0][k])
        distance += failing * legs[k + 1]
    slope = ca.gradient(distance, z)
    direction = ca.SX.sym("direction", z.numel())
    return PassageProgramme(
        ca.Function("distance", [z], [distance]),
        ca.Function("slope", [z], [slope]),
        ca.Function("along", [z, direction], [ca.jtimes(slope, z, direction)]),
    )


def _failing(z: Any, steps: int) -> list[Any]:
    """The chance of no connection to one station up to each place, of its mean and covariance."""
    mean = [z[k] for k in range(steps)]
    covariance = [[z[steps * (1 + j) + i] for j in range(steps)] for i in range(steps)]
    failing: Any = 1.0
    found: list[Any] = []
    for k in range(steps):
        deviation = ca.sqrt(covariance[k][k])
        score = ca.fmax(-mean[k] / deviation, LEAST_SCORE)
        below = 0.5 * (1.0 + ca.erf(score / math.sqrt(2.0)))
        ratio = ca.exp(-0.5 * score * score) / math.sqrt(2.0 * math.pi) / below
        failing = failing * below
        found.append(failing)
        shrink = ratio * (ratio + score) / covariance[k][k]
        for i in range(k + 1, steps):
            mean[i] -= covariance[i][k] / deviation * ratio
            for j in range(k + 1, i + 1):
                covariance[i][j] -= covariance[i][k] * covariance[j][k] * shrink
    return found


def charged_distance_derivatives(
    channels: Sequence[LocalChannel],
    path_m: NDArray[np.float64],  # (h, 2)
    settings: Search,
    width_m: float,
    beyond: Derivatives | None = None,  # Cost of ending without connection, by the last place
    tried: NDArray[np.bool_] | None = None,  # (h,)
) -> PathDerivatives:
    """:func:`planopt.objectives.until_connected.charged_distance_m`, filtered, with derivatives."""
    stations = [LocalPath(channel, path_m) for channel in channels]
    steps = len(path_m)
    legs = rounded_length(np.diff(np.vstack([settings.start_m, path_m]), axis=0), width_m)
    if settings.step_m is not None:
        driven = 1.0 - WAITING
        counted = counted_legs_m(legs.value, settings.step_m)
        legs = Derivatives(counted, driven * legs.gradient, driven * legs.hessian)
    if beyond is None:
        beyond = Derivatives(np.array([settings.beyond_m]), np.zeros((1, 2)), np.zeros((1, 3)))
    missing_db = 0.0 if tried is None else np.where(tried, 0.0, NOT_TRIED_DB)
    z: list[NDArray[np.float64]] = []
    # Derivatives of z by the coordinates.
    jacobian: list[NDArray[np.float64]] = []
    for station, threshold in zip(stations, settings.thresholds_dbm, strict=True):
        z += [
            station.power_mean.value - threshold - missing_db,
            station.universal.value.ravel(),
        ]
        jacobian += _jacobians(station)
    by_beyond = np.zeros((1, 2 * steps))
    by_beyond[0, -2:] = beyond.gradient[0]
    point = np.concatenate([*z, legs.value, beyond.value])
    directions = np.concatenate([*jacobian, length_jacobian(legs), by_beyond])

    programme = passage_programme(steps, len(stations))
    gradient = np.asarray(programme.gradient(point)).ravel()
    hessian = directions.T @ np.asarray(programme.along(point, directions))
    size = steps * (steps + 1)
    for number, station in enumerate(stations):
        own = gradient[number * size : (number + 1) * size]
        by_s = own[steps:].reshape(steps, steps)
        hessian += station.universal.curvature(0.5 * (by_s + by_s.T))
        add_own_blocks(hessian, own[:steps, None] * station.power_mean.hessian)
    hessian += by_lengths(legs, gradient[-steps - 1 : -1])[1]
    xx, xy, yy = gradient[-1] * beyond.hessian[0]
    hessian[-2:, -2:] += [[xx, xy], [xy, yy]]
    return PathDerivatives(
        float(programme.value(point)), directions.T @ gradient, 0.5 * (hessian + hessian.T)
    )


def _jacobians(station: LocalPath) -> list[NDArray[np.float64]]:
    """Derivatives of mean (h, 2 h) and covariance (h h, 2 h) of one station by the coordinates."""
    steps = station.steps
    k = np.arange(steps)
    by_mean = np.zeros((steps, steps, 2))
    by_mean[k, k] = station.power_mean.gradient
    by_covariance = np.zeros((steps, steps, steps, 2))
    first = station.universal.first.reshape(steps, 2, steps)
    by_covariance[k, :, k] += first.transpose(0, 2, 1)
    by_covariance[:, k, k] += first.transpose(2, 0, 1)
    return [by_mean.reshape(steps, -1), by_covariance.reshape(steps * steps, -1)]
