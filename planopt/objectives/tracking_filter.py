"""Tracking as the station's filter sees it, and what the packets of a path are worth to it.

The bound on information holds however the losses belong together. The recursion for the covariance
holds for losses that are independent in time, which under shadowing they are not: with the outdoor
channel of [GM11] it claims a third to an eighteenth of what is true. It is never a bound there, and
only sampling the joint law of the losses says what is to be expected (equations 4.9 to 4.13).

Two measures (equations 4.9 to 4.13), of one robot's path or of many at once:

- :func:`information_gain`: at least the expected gain of information, however losses belong
  together; for one step equation 4.11;
- :func:`covariance_gain`: the covariance recursion, which takes losses as independent in time.
  Under shadowing they are not, and it is no bound.

:mod:`planopt.objectives.tracking_scenarios` has the expected gain itself, over drawn channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.sampled_distribution import SampledDistribution
from planopt.channel.joint import sample_power
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.local_channel import factored_near
from planopt.objectives.tracking import Tracking, delivery
from planopt.objectives.tracking_estimates import Held
from planopt.targets.information_filter import (
    TargetModel,
    covariance_of,
    position_variance_m2,
    predicted_information,
    require_covariance,
)
from planopt.targets.sensor import sensing_information

Criterion = Literal["trace", "determinant", "norm"]
"""Of the covariance of the target's position: m^2, m^4, and its largest eigenvalue in m^2."""


@dataclass(frozen=True, eq=False)
class FilteredTracking:
    """A target to be tracked, what the station knows of it now, and the other robots' packets."""

    tracking: Tracking  # The target and the sensor
    model: TargetModel  # How the target moves
    information: NDArray[np.float64]  # (4, 4) J_{t|t} at the station
    # (2, h, m) probability that each packet of m other robots arrives, and its tr Lambda^-1 per
    # m^2, as their plans have it; None without any
    others: NDArray[np.float64] | None = None
    # What is measured of the covariance, by :mod:`planopt.objectives.tracking_scenarios` alone
    criterion: Criterion = "trace"
    # What robots hold, where packets have estimates; for that module alone
    held: Held | None = None

    def __post_init__(self) -> None:
        require_covariance(self.information, 4, "information")


def information_bound(
    posteriors: Sequence[ChannelPosterior],
    paths_m: Sequence[NDArray[np.float64]],
    settings: FilteredTracking,
) -> float:
    """Return sum_k w_k tr J-bar_k, at least sum_k w_k E tr J_k (equation 4.12); a value.

    J-bar_{k+1} = (A J-bar_k^-1 A' + B Theta B')^-1 + sum_i p_i H' Lambda_i^-1 H. The prediction is
    concave in J and the update linear in the losses, so that this holds whatever their joint law
    is. For h = 1 it is equation 4.11 plus a constant. The trace is of position (per m^2) and
    velocity (s^2 / m^2) together.
    """
    arrival, sensing = delivery(posteriors, paths_m, settings.tracking)
    matrices = bounding_information(arrival, sensing, settings)
    return float(settings.tracking.weight @ np.trace(matrices, axis1=1, axis2=2))


def bounding_information(
    arrival: NDArray[np.float64], sensing: NDArray[np.float64], settings: FilteredTracking
) -> NDArray[np.float64]:
    """J-bar_1 .. J-bar_h ``(..., h, 4, 4)`` for p and tr Lambda^-1 of each step and robot.

    With p in {0, 1} it is the filter itself: J of these losses.
    """
    # Shapes: arrival (..., h, N); sensing (..., h, N).
    # Lambda^-1 = tr(Lambda^-1) / 2 times I_2.
    received = 0.5 * (arrival * sensing).sum(axis=-1)
    batch, steps = received.shape[:-1], received.shape[-1]
    matrix = np.broadcast_to(settings.information, (*batch, 4, 4))
    found = np.empty((*batch, steps, 4, 4))
    for k in range(steps):
        matrix = predicted_information(settings.model, matrix)
        matrix[..., 0, 0] += received[..., k]
        matrix[..., 1, 1] += received[..., k]
        found[..., k, :, :] = matrix
    return found


def covariance_recursion_m2(
    posteriors: Sequence[ChannelPosterior],
    paths_m: Sequence[NDArray[np.float64]],
    settings: FilteredTracking,
) -> float:
    """sum_k w_k tr P-bar_k of the position, m^2 (the modified Riccati equation); a cost.

    P-bar+ = P- - p P- H' (H P- H' + Lambda)^-1 H P-, for the robots one after the other. It is at
    least E tr P where losses are independent in time. **Under shadowing it is no bound and far too
    small** (equation 4.13): report :func:`sampled_tracking` instead. Arguments as
    :func:`information_bound`.
    """
    arrival, sensing = delivery(posteriors, paths_m, settings.tracking)
    covariances = riccati_covariances(arrival, sensing, settings)
    return float(settings.tracking.weight @ np.trace(covariances[:, :2, :2], axis1=1, axis2=2))


def riccati_covariances(
    arrival: NDArray[np.float64], sensing: NDArray[np.float64], settings: FilteredTracking
) -> NDArray[np.float64]:
    """P-bar_1 .. P-bar_h; ``(..., h, 4, 4)``. Arguments as :func:`bounding_information`."""
    model = settings.model
    transition, noise = model.transition, model.process_covariance
    arrival, sensing = np.broadcast_arrays(arrival, sensing)
    spread = covariance_of(settings.information)
    found = np.empty((*arrival.shape[:-1], 4, 4))
    for k in range(arrival.shape[-2]):
        spread = transition @ spread @ transition.T + noise
        for robot in range(arrival.shape[-1]):
            chance, information = (each[..., k, robot, None, None] for each in (arrival, sensing))
            innovation = spread[..., :2, :2] + (2.0 / information) * np.eye(2)
            seen = spread[..., :2, :]
            gain = np.asarray(np.linalg.solve(innovation, seen), dtype=np.float64)
            spread = spread - chance * gain.swapaxes(-1, -2) @ seen
        found[..., k, :, :] = spread
    return found


def sampled_tracking(
    posteriors: Sequence[ChannelPosterior],
    paths_m: Sequence[NDArray[np.float64]],
    settings: FilteredTracking,
    measure: Literal["information", "covariance"],
    count: int,
    generator: np.random.Generator,
) -> SampledDistribution:
    """Draws of sum_k w_k tr J_k (a value) or of sum_k w_k tr P_k of the position, m^2 (a cost).

    Losses are drawn from the joint law of the powers, so that outages last as long as they will.
    `mean()` of the result is the objective with its interval. The same generator state gives the
    same draws: sample average approximation.
    """
    if measure not in ("information", "covariance"):
        raise InputError(f"{measure!r} is no measure", key="measure")
    _, sensing = delivery(posteriors, paths_m, settings.tracking)
    arrived = sampled_arrivals(posteriors, paths_m, settings.tracking, count, generator)
    matrices = bounding_information(arrived.astype(np.float64), sensing, settings)
    if measure == "information":
        each = np.trace(matrices, axis1=2, axis2=3)
    else:
        each = position_variance_m2(matrices)
    return SampledDistribution(each @ settings.tracking.weight)


def sampled_arrivals(
    posteriors: Sequence[ChannelPosterior],
    paths_m: Sequence[NDArray[np.float64]],
    settings: Tracking,
    count: int,
    generator: np.random.Generator,
) -> NDArray[np.bool_]:
    """``(count, h, N)`` lambda: which packets arrive, drawn given the measurements."""
    steps = len(settings.target_m)
    arrived = np.zeros((count, steps, len(posteriors)), dtype=np.bool_)
    for posterior in {id(each): each for each in posteriors}.values():
        robots = [i for i, each in enumerate(posteriors) if each is posterior]
        places = np.concatenate([paths_m[i] for i in robots])
        near = factored_near(posterior, places)
        power = sample_power(near, places, count, generator)
        up = (power >= settings.threshold_dbm).reshape(count, len(robots), steps)
        arrived[:, :, robots] = up.transpose(0, 2, 1)
    return arrived


def information_gain(
    arrival: NDArray[np.float64], sensing: NDArray[np.float64], settings: FilteredTracking
) -> NDArray[np.float64]:
    """sum_k w_k (tr J-bar_k - tr J_k without own packets); ``(...)``.

    The trace is of position (per m^2) and velocity (s^2 / m^2) together.
    """
    # Shapes: arrival, sensing (..., h).
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
