# pyright: basic
"""Expected distance along a path until connected (equation 4.13): a cost in metres.

Plans are evaluated by assumed-density filtering (equation 4.15). Positions are visited in turn.
Given no connection so far, the power at all later positions is approximated by a Gaussian with the
exact moments. The result is within hundredths of the multivariate integral
(:func:`planopt.channel.first_passage`) at a hundredth of its cost. For solvers, CasADi
differentiates the formula w.r.t. the moments of the path, whose derivatives
:mod:`planopt.objectives.path_derivatives` provides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.joint import joint_prediction
from planopt.channel.kriging import LocalChannel
from planopt.channel.parameters import leg_lengths_m, require_places
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.channel.prediction import score_probability
from planopt.objectives.path_derivatives import (
    LocalPath,
    PathDerivatives,
    add_own_blocks,
    by_lengths,
    length_jacobian,
)
from planopt.targets.rounding import Derivatives, rounded_length

WAITING = 0.1
"""Cost per metre by which a step is shorter than the longest step. Without it, waiting would be
free, and the robot would postpone its first step forever."""

NOT_PROBED_DB = 1e3
"""Offset in dB that puts positions without a probe far below the threshold."""

LEAST_CHANCE = 1e-12
"""Minimum probability of connection of a probed position."""

PROBE_SHARE = 1.0 / 3.0
"""Expected distance between probes as a share of the decorrelation distance. For 1/6 to 2/3,
searches from 40 start positions on one map were within a tenth of the best."""

LEAST_VARIANCE_DB2 = 1e-12
"""Minimum variance, for positions whose power is known exactly."""

LEAST_SCORE = -5.0
"""Minimum score: the outage probability of a position is at least Q(5) = 3e-7."""


@dataclass(frozen=True)
class Search:
    """Settings of a search for connection."""

    start_m: tuple[float, float]  # Position of the robot
    thresholds_dbm: tuple[float, ...]  # Minimum power of a connection to each station
    beyond_m: float = 0.0  # Metres added if the path ends without connection
    step_m: float | None = None  # Longest step, for the cost of waiting; None if it is free


def charged_distance_m(
    posteriors: Sequence[ChannelPosterior],
    path_m: NDArray[np.float64],  # (h, 2)
    settings: Search,
    probed: NDArray[np.bool_] | None = None,  # (h,) True where the robot probes; None: all
) -> float:
    """Return E[D] + beyond_m P(not connected at q_1 .. q_h), by the exact posteriors."""
    # E[D] alone is smallest for a stationary robot, so leg lengths are those of `counted_legs_m`.
    # Stations are independent, so their outage probabilities multiply.
    places = require_places(path_m)
    missing_db = 0.0 if probed is None else np.where(probed, 0.0, NOT_PROBED_DB)
    powers = [joint_prediction(factored_near(each, places), places) for each in posteriors]
    stations = [
        ((power.mean_db - threshold - missing_db)[None], power.covariance_db2[None])
        for power, threshold in zip(powers, settings.thresholds_dbm, strict=True)
    ]
    legs = leg_lengths_m(np.vstack([np.asarray(settings.start_m), places]))
    counted = counted_legs_m(legs, settings.step_m)
    return float(charged_distances_m(stations, counted[None], settings.beyond_m)[0])


def counted_legs_m(legs_m: NDArray[np.float64], step_m: float | None) -> NDArray[np.float64]:
    """Return leg lengths plus `WAITING` times their shortfall from the longest step `step_m`."""
    return legs_m if step_m is None else (1.0 - WAITING) * legs_m + WAITING * step_m


def charged_distances_m(
    stations: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
    legs_m: NDArray[np.float64],  # (c, h) counted lengths of the steps
    beyond_m: NDArray[np.float64] | float,
) -> NDArray[np.float64]:
    """Return the cost of :func:`charged_distance_m` for c paths of h positions; ``(c,)``."""
    failing = np.ones_like(legs_m)
    for above_db, covariance_db2 in stations:
        failing *= filtered_failing(above_db, covariance_db2)
    return (
        legs_m[:, 0]
        + np.einsum("ck,ck->c", legs_m[:, 1:], failing[:, :-1])
        + beyond_m * failing[:, -1]
    )


def filtered_failing(
    above_db: NDArray[np.float64], covariance_db2: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return P(no connection up to each position) of c paths (equation 4.15); ``(c, h)``."""
    # Shapes: above_db (c, h); covariance_db2 (c, h, h).
    mean, covariance = above_db.copy(), covariance_db2.copy()
    below = np.empty_like(mean)
    for k in range(int(mean.shape[1])):
        variance = np.maximum(covariance[:, k, k], LEAST_VARIANCE_DB2)
        deviation = np.sqrt(variance)
        score = np.maximum(-mean[:, k] / deviation, LEAST_SCORE)
        below[:, k] = score_probability(score)
        ratio = np.exp(-0.5 * score * score) / math.sqrt(2.0 * math.pi) / below[:, k]
        shared = covariance[:, k, k + 1 :].copy()
        mean[:, k + 1 :] -= (ratio / deviation)[:, None] * shared
        shrink = ratio * (ratio + score) / variance
        covariance[:, k + 1 :, k + 1 :] -= (
            shrink[:, None, None] * shared[:, :, None] * shared[:, None, :]
        )
    return np.asarray(np.cumprod(below, axis=1), dtype=np.float64)


def search_length_m(
    distance_m: NDArray[np.float64], chance: NDArray[np.float64], decorrelation_m: float
) -> NDArray[np.float64]:
    """Return the expected length of a search by its first probe, R = D + L (1 - P) / P."""
    # The first probe costs the path length D to its position. Each further probe is nearby, equally
    # likely to succeed, and costs L, `PROBE_SHARE` of the decorrelation distance.
    # Shapes: distance_m, chance (k,).
    odds_against = (1.0 - chance) / np.maximum(chance, LEAST_CHANCE)
    return distance_m + PROBE_SHARE * decorrelation_m * odds_against


@dataclass(frozen=True)
class PassageProgramme:
    """CasADi functions of the flat vector z."""

    # z stacks (mean above threshold (h,), covariance (h, h)) of each station, the leg lengths (h,)
    # and the cost of ending without connection. Outage probabilities of stations multiply.

    value: Any  # Function of z: expected cost in metres
    gradient: Any  # Gradient w.r.t. z, with covariances as lower triangles
    along: Any  # Function of z and a direction: directional derivative of the gradient


@cache
def passage_programme(steps: int, stations: int = 1) -> PassageProgramme:
    """Build the functions for a path of h = `steps` positions; cached per number of steps."""
    import casadi as ca

    size = steps * (steps + 1)
    z = ca.SX.sym("z", stations * size + steps + 1)
    each = [_failing(z[own * size : (own + 1) * size], steps) for own in range(stations)]
    legs = z[stations * size :]  # The last entry is the cost beyond the path
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
    """Return P(no connection to one station up to each position) from mean and covariance."""
    import casadi as ca

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
    beyond: Derivatives | None = None,  # Cost of ending unconnected at the last position
    probed: NDArray[np.bool_] | None = None,  # (h,)
) -> PathDerivatives:
    """Return :func:`charged_distance_m` for local channels, filtered, with derivatives."""
    stations = [LocalPath(channel, path_m) for channel in channels]
    steps = len(path_m)
    legs = rounded_length(np.diff(np.vstack([settings.start_m, path_m]), axis=0), width_m)
    if settings.step_m is not None:
        driven = 1.0 - WAITING
        counted = counted_legs_m(legs.value, settings.step_m)
        legs = Derivatives(counted, driven * legs.gradient, driven * legs.hessian)
    if beyond is None:
        beyond = Derivatives(np.array([settings.beyond_m]), np.zeros((1, 2)), np.zeros((1, 3)))
    missing_db = 0.0 if probed is None else np.where(probed, 0.0, NOT_PROBED_DB)
    z: list[NDArray[np.float64]] = []
    # Derivatives of z w.r.t. the coordinates.
    jacobian: list[NDArray[np.float64]] = []
    for station, threshold in zip(stations, settings.thresholds_dbm, strict=True):
        z += [station.power_mean.value - threshold - missing_db, station.universal.value.ravel()]
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
    """Return the Jacobians of mean (h, 2 h) and covariance (h h, 2 h) of one station."""
    steps = station.steps
    k = np.arange(steps)
    by_mean = np.zeros((steps, steps, 2))
    by_mean[k, k] = station.power_mean.gradient
    by_covariance = np.zeros((steps, steps, steps, 2))
    first = station.universal.first.reshape(steps, 2, steps)
    by_covariance[k, :, k] += first.transpose(0, 2, 1)
    by_covariance[:, k, k] += first.transpose(2, 0, 1)
    return [by_mean.reshape(steps, -1), by_covariance.reshape(steps * steps, -1)]
