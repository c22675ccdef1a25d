"""The expected distance along a path until connected (equation 4.13): a cost, in metres.

Plans are valued by assumed-density filtering (equation 4.15): places are taken in turn, and given
that the earlier ones are not connected, power at all later ones is taken as Gaussian again, with
the moments that it truly has. It is within hundredths of the multivariate integral
(:func:`planopt.channel.path_connectivity.first_passage`) and costs a hundredth of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.joint import joint_prediction
from planopt.channel.parameters import leg_lengths_m, require_places
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.channel.prediction import score_probability

WAITING = 0.1
"""What a metre counts that a step could be longer. Were it nothing, a robot could as well wait as
drive: it would put off its first step again and again."""

NOT_TRIED_DB = 1e3
"""So far below the threshold the searches' formula takes places that are no tries."""

LEAST_CHANCE = 1e-12
"""Of a place that is tried."""

TRY_SHARE = 1.0 / 3.0
"""How far apart tries are expected to be, as a share of the decorrelation distance. From 1/6 to 2/3
searches from 40 starts on one map were within a tenth of the best; as tries that all begin where
the robot is, D / P + L (1 - P) / P with the whole decorrelation distance, they drove a tenth
farther."""

LEAST_VARIANCE_DB2 = 1e-12
"""Of a place whose power is known exactly."""

LEAST_SCORE = -5.0
"""A place that misses connection with a smaller chance than Q(5), 3e-7, counts as one with that."""


@dataclass(frozen=True)
class Search:
    """A search for connection."""

    start_m: tuple[float, float]  # Where the robot is
    thresholds_dbm: tuple[float, ...]  # Power from which on a place is connected to each station
    beyond_m: float = 0.0  # Metres added for a path that ends without connection
    # Longest step, for what :func:`counted_legs_m` adds for waiting; None where it is free
    step_m: float | None = None


def charged_distance_m(
    posteriors: Sequence[ChannelPosterior],
    path_m: NDArray[np.float64],  # (h, 2)
    settings: Search,
    tried: NDArray[np.bool_] | None = None,  # (h,) which places are probed; None: all
) -> float:
    """Return E[D] + beyond_m P(not connected at q_1 .. q_h), by the exact posteriors.

    E[D] alone is least for a robot that stands still, so that legs are those of
    :func:`counted_legs_m`. Stations are independent: the probabilities of no connection to each of
    them multiply.
    """
    places = require_places(path_m)
    missing_db = 0.0 if tried is None else np.where(tried, 0.0, NOT_TRIED_DB)
    powers = [joint_prediction(factored_near(each, places), places) for each in posteriors]
    stations = [
        ((power.mean_db - threshold - missing_db)[None], power.covariance_db2[None])
        for power, threshold in zip(powers, settings.thresholds_dbm, strict=True)
    ]
    legs = leg_lengths_m(np.vstack([np.asarray(settings.start_m), places]))
    counted = counted_legs_m(legs, settings.step_m)
    return float(charged_distances_m(stations, counted[None], settings.beyond_m)[0])


def counted_legs_m(legs_m: NDArray[np.float64], step_m: float | None) -> NDArray[np.float64]:
    """Return legs with `WAITING` times what each is shorter than the longest step, `step_m`."""
    return legs_m if step_m is None else (1.0 - WAITING) * legs_m + WAITING * step_m


def charged_distances_m(
    stations: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
    legs_m: NDArray[np.float64],  # (c, h) what the steps count
    beyond_m: NDArray[np.float64] | float,
) -> NDArray[np.float64]:
    """Return what c paths of h places are charged, as :func:`charged_distance_m`; ``(c,)``."""
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
    """Chance of no connection up to each place of c paths, by filtering (equation 4.15); (c, h)."""
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

    The first try costs the way to its place, D, and each further one L, `TRY_SHARE` of the
    decorrelation distance: it is as likely to succeed as the first, and near it.
    """
    # Shapes: distance_m, chance (k,).
    odds_against = (1.0 - chance) / np.maximum(chance, LEAST_CHANCE)
    return distance_m + TRY_SHARE * decorrelation_m * odds_against
