"""What the packets of a path are worth to the station's filter, less that of receiving nothing.

Three measures (equations 4.9 to 4.13), of one robot's path or of many at once:

- :func:`information_gain`: at least the expected gain of information, however losses belong
  together; for one step equation 4.11;
- :func:`covariance_gain`: the covariance recursion, which takes losses as independent in time.
  Under shadowing they are not, and it is no bound;
- :func:`sampled_gain`: the expected gain itself, over a fixed set of draws of the joint law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.tracking_filter import (
    FilteredTracking,
    bounding_information,
    riccati_covariances,
    sampled_arrivals,
)
from planopt.targets.sensor import sensing_information

DRAWS = 512
"""Joint outcomes of the losses that the sampled form averages over: a standard error of about a
fiftieth of the spread between outcomes."""

SEED = 0
"""Of these draws: the same numbers for every path, so that paths are compared by the same luck."""


def information_gain(
    arrival: NDArray[np.float64], sensing: NDArray[np.float64], settings: FilteredTracking
) -> NDArray[np.float64]:
    """sum_k w_k (tr J-bar_k - tr J_k without packets); ``(...)``.

    The trace is of position (per m^2) and velocity (s^2 / m^2) together.

    Parameters
    ----------
    arrival, sensing
        ``(..., h)`` p and tr Lambda^-1 per m^2.
    settings
        The target and what is known of it.
    """
    matrices = bounding_information(arrival[..., None], sensing[..., None], settings)
    none = np.zeros((len(settings.tracking.weight), 1))
    gained = matrices - bounding_information(none, none, settings)
    return np.trace(gained, axis1=-2, axis2=-1) @ settings.tracking.weight


def covariance_gain(
    arrival: NDArray[np.float64], sensing: NDArray[np.float64], settings: FilteredTracking
) -> NDArray[np.float64]:
    """sum_k w_k (tr P_k without packets - tr P-bar_k) of the position, m^2; ``(...)``.

    Arguments as :func:`information_gain`.
    """
    spread = riccati_covariances(arrival[..., None], sensing[..., None], settings)
    removed = unobserved_covariances(settings) - spread
    return np.trace(removed[..., :2, :2], axis1=-2, axis2=-1) @ settings.tracking.weight


def sampled_gain(
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],
    settings: FilteredTracking,
    further: Sequence[tuple[ChannelPosterior, float]] = (),
) -> float:
    """sum_k w_k (tr P_k without packets - E tr P_k) of the position, m^2, over `DRAWS` draws.

    A packet arrives where the power of any station reaches its threshold.

    Parameters
    ----------
    posterior
        The channel given measurements.
    path_m
        ``(h, 2)``.
    settings
        The target and what is known of it.
    further
        The channel of each further station, and the power from which that connects.
    """
    generator = np.random.default_rng(SEED)
    arrived = np.zeros((DRAWS, len(path_m)), dtype=np.bool_)
    for station, threshold in ((posterior, settings.tracking.threshold_dbm), *further):
        own = replace(settings.tracking, threshold_dbm=threshold)
        arrived |= sampled_arrivals([station], [path_m], own, DRAWS, generator)[:, :, 0]
    outcomes, counts = np.unique(arrived, axis=0, return_counts=True)
    sensing = sensing_of(path_m, settings)
    return float(covariance_gain(outcomes.astype(np.float64), sensing, settings) @ counts) / DRAWS


def first_steps(settings: FilteredTracking, count: int) -> FilteredTracking:
    """The settings for a path that is not complete yet."""
    tracking = settings.tracking
    few = replace(tracking, target_m=tracking.target_m[:count], weight=tracking.weight[:count])
    return replace(settings, tracking=few)


def sensing_of(places_m: NDArray[np.float64], settings: FilteredTracking) -> NDArray[np.float64]:
    """Tr Lambda^-1 of every stage of paths ``(..., h, 2)``, per m^2; ``(..., h)``."""
    return sensing_information(settings.tracking.sensor, places_m, settings.tracking.target_m)


def unobserved_covariances(settings: FilteredTracking) -> NDArray[np.float64]:
    """P_1 .. P_h where no packet arrives; ``(h, 4, 4)``."""
    steps = len(settings.tracking.weight)
    return riccati_covariances(np.zeros((steps, 1)), np.ones((steps, 1)), settings)
