# pyright: basic
"""The expected distance along a path until connected (equation 4.13): a cost, in metres.

Plans are valued by assumed-density filtering (equation 4.15): places are taken in turn, and given
that the earlier ones are not connected, power at all later ones is taken as Gaussian again, with
its exact moments. It is within hundredths of the multivariate integral
(:func:`planopt.channel.first_passage`) and costs a hundredth of it. For solvers, CasADi
differentiates the formula by the moments of the path, whose derivatives are those of
:mod:`planopt.objectives.path_derivatives`.
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
"""Cost of each metre by which a step is shorter than the longest. Without it, waiting would cost
nothing, and the robot would put off its first step again and again."""

NOT_PROBED_DB = 1e3
"""Places that are not probed are taken to be so far below the threshold."""

LEAST_CHANCE = 1e-12
"""Minimum probability of connection of a probed place."""

PROBE_SHARE = 1.0 / 3.0
"""Expected distance between probes as a share of the decorrelation distance. From 1/6 to 2/3
searches from 40 starts on one map were within a tenth of the best."""

LEAST_VARIANCE_DB2 = 1e-12
"""Minimum variance, for places whose power is known exactly."""

LEAST_SCORE = -5.0
"""Minimum score: no place misses connection with a smaller probability than Q(5), 3e-7."""


@dataclass(frozen=True)
class Search:
    """A search for connection."""

    start_m: tuple[float, float]  # Where the robot is
    thresholds_dbm: tuple[float, ...]  # Power from which on a place is connected to each station
    beyond_m: float = 0.0  # Metres added for a path that ends without connection
    step_m: float | None = None  # Longest step, for the cost of waiting; None if it is free


def charged_distance_m(
    posteriors: Sequence[ChannelPosterior],
    path_m: NDArray[np.float64],  # (h, 2)
    settings: Search,
    probed: NDArray[np.bool_] | None = None,  # (h,) which places are probed; None: all
) -> float:
    """Return E[D] + beyond_m P(not connected at q_1 .. q_h), by the exact posteriors.

    E[D] alone is least for a robot that stands still, so that legs are those of
    :func:`counted_legs_m`. Stations are independent: the probabilities of no connection to each of
    them multiply.
    """
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
    """Return legs plus `WAITING` times their difference from the longest step, `step_m`."""
    return legs_m if step_m is None else (1.0 - WAITING) * legs_m + WAITING * step_m


def charged_distances_m(
    stations: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
    legs_m: NDArray[np.float64],  # (c, h) what the steps count
    beyond_m: NDArray[np.float64] | float,
) -> NDArray[np.float64]:
    """Return the costs of c paths of h places, as :func:`charged_distance_m`; ``(c,)``."""
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
    """Return P(no connection up to each place) of c paths by filtering (equation 4.15); (c, h)."""
    # Shapes: above_db, covariance_db2 (c, h).
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
    distance_m: NDArray[np.float64],
    chance: NDArray[np.float64],
    decorrelation_m: float,
) -> NDArray[np.float64]:
    """Return the expected length of a search that begins at a place, R = D + L (1 - P) / P.

    The first probe costs the path to its place, D, and each further one L, `PROBE_SHARE` of the
    decorrelation distance: it is as likely to succeed as the first, and near it.
    """
    # Shapes: distance_m, chance (k,).
    odds_against = (1.0 - chance) / np.maximum(chance, LEAST_CHANCE)
    return distance_m + PROBE_SHARE * decorrelation_m * odds_against


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
    import casadi as ca

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
    """Return P(no connection to one station up to each place), from its mean and covariance."""
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
    beyond: Derivatives | None = None,  # Cost of ending without connection, by the last place
    probed: NDArray[np.bool_] | None = None,  # (h,)
) -> PathDerivatives:
    """Return the filtered :func:`charged_distance_m` by local channels with derivatives."""
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
    """Return derivatives of mean (h, 2 h) and covariance (h h, 2 h) of one station."""
    steps = station.steps
    k = np.arange(steps)
    by_mean = np.zeros((steps, steps, 2))
    by_mean[k, k] = station.power_mean.gradient
    by_covariance = np.zeros((steps, steps, steps, 2))
    first = station.universal.first.reshape(steps, 2, steps)
    by_covariance[k, :, k] += first.transpose(0, 2, 1)
    by_covariance[:, k, k] += first.transpose(2, 0, 1)
    return [by_mean.reshape(steps, -1), by_covariance.reshape(steps * steps, -1)]
