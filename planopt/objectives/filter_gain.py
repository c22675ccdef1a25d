"""What the packets of a path are worth to the station's filter, less that of receiving nothing.

Two measures (equations 4.9 to 4.13), of one robot's path or of many at once:

- :func:`information_gain`: at least the expected gain of information, however losses belong
  together; for one step equation 4.11;
- :func:`covariance_gain`: the covariance recursion, which takes losses as independent in time.
  Under shadowing they are not, and it is no bound.

:mod:`planopt.objectives.tracking_scenarios` has the expected gain itself, over drawn channels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.tracking_filter import (
    FilteredTracking,
    bounding_information,
    riccati_covariances,
)
from planopt.targets.sensor import sensing_information


def information_gain(
    arrival: NDArray[np.float64], sensing: NDArray[np.float64], settings: FilteredTracking
) -> NDArray[np.float64]:
    """sum_k w_k (tr J-bar_k - tr J_k without own packets); ``(...)``.

    The trace is of position (per m^2) and velocity (s^2 / m^2) together.

    Parameters
    ----------
    arrival, sensing
        ``(..., h)`` p and tr Lambda^-1 per m^2.
    settings
        The target and what is known of it.
    """
    matrices = bounding_information(*with_others(arrival, sensing, settings), settings)
    gained = matrices - bounding_information(*others_alone(settings), settings)
    return np.trace(gained, axis1=-2, axis2=-1) @ settings.tracking.weight


def covariance_gain(
    arrival: NDArray[np.float64], sensing: NDArray[np.float64], settings: FilteredTracking
) -> NDArray[np.float64]:
    """sum_k w_k (tr P_k without own packets - tr P-bar_k) of the position, m^2; ``(...)``.

    Arguments as :func:`information_gain`.
    """
    spread = riccati_covariances(*with_others(arrival, sensing, settings), settings)
    removed = unobserved_covariances(settings) - spread
    return np.trace(removed[..., :2, :2], axis1=-2, axis2=-1) @ settings.tracking.weight


def with_others(
    arrival: NDArray[np.float64], sensing: NDArray[np.float64], settings: FilteredTracking
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return p and tr Lambda^-1 (..., h, robots) of the others, and the robot's own, last."""
    own = arrival[..., None], sensing[..., None]
    if settings.others is None:
        return own
    shape = np.broadcast_shapes(arrival.shape, sensing.shape)
    found = [
        np.concatenate(
            [
                np.broadcast_to(theirs, (*shape, theirs.shape[-1])),
                np.broadcast_to(mine, (*shape, 1)),
            ],
            axis=-1,
        )
        for theirs, mine in zip(settings.others, own, strict=True)
    ]
    return found[0], found[1]


def others_alone(settings: FilteredTracking) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return p and tr Lambda^-1 (h, robots) of the other robots; of one that sends nothing."""
    if settings.others is not None:
        return settings.others[0], settings.others[1]
    steps = len(settings.tracking.weight)
    return np.zeros((steps, 1)), np.ones((steps, 1))


def first_steps(settings: FilteredTracking, count: int) -> FilteredTracking:
    """The settings for a path that is not complete yet."""
    tracking = settings.tracking
    few = replace(tracking, target_m=tracking.target_m[:count], weight=tracking.weight[:count])
    others = None if settings.others is None else settings.others[:, :count]
    return replace(settings, tracking=few, others=others)


def sensing_of(places_m: NDArray[np.float64], settings: FilteredTracking) -> NDArray[np.float64]:
    """Tr Lambda^-1 of every stage of paths ``(..., h, 2)``, per m^2; ``(..., h)``."""
    return sensing_information(settings.tracking.sensor, places_m, settings.tracking.target_m)


def unobserved_covariances(settings: FilteredTracking) -> NDArray[np.float64]:
    """P_1 .. P_h where no packet of the robot's own arrives; ``(h, 4, 4)``."""
    return riccati_covariances(*others_alone(settings), settings)
