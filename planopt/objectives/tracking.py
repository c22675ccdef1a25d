"""Tracking: information that reaches the station, summed over steps, with derivatives.

A packet counts with the probability that it arrives. Summed over steps and robots that needs no
joint law, so that a dynamic programme can plan with it; :mod:`planopt.objectives.tracking_filter`
has the forms that follow the filter itself.

The chain rule only: where the prediction and its derivatives come from is the caller's choice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planopt.channel.places import require_finite, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import score_probability
from planopt.errors import InputError
from planopt.plain_values import require_weights
from planopt.targets.rounding import Derivatives, add_products
from planopt.targets.sensor import Sensor, sensing_information


@dataclass(frozen=True, eq=False)
class Tracking:
    """A target to be tracked over the next h steps."""

    threshold_dbm: float  # Upsilon_TH: packets below this power are dropped
    sensor: Sensor  # How well it is sensed
    target_m: NDArray[np.float64]  # (h, 2) p_hat_{t+k|t}, k = 1 .. h.
    # (h,) w_k >= 0 of the steps. Not given: all one.
    weight: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        require_finite(self.threshold_dbm, "threshold_dbm")
        count = len(require_places(self.target_m))
        if self.weight.shape == (0,):
            object.__setattr__(self, "weight", np.ones(count))
        require_weights(self.weight, count)


def tracking_reward(
    connectivity: NDArray[np.float64],  # (n,) P(power >= threshold) at each place
    positions_m: NDArray[np.float64],  # (n, 2)
    stage: int,
    settings: Tracking,
) -> NDArray[np.float64]:
    """Return w_k P(connected) tr Phi^-1(q, p_hat_{t+k|t}) per m^2 (equation 4.11); ``(n,)``."""
    sensing = sensing_information(settings.sensor, positions_m, settings.target_m[stage])
    return settings.weight[stage] * connectivity * sensing


def tracking_stage_rewards(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    stage: int,
    settings: Tracking,
) -> NDArray[np.float64]:
    """:func:`tracking_reward` with the connectivity of `posterior`, today's deviation in it."""
    connectivity = posterior.connectivity(positions_m, settings.threshold_dbm)
    return tracking_reward(connectivity, positions_m, stage, settings)


def tracking_value(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], settings: Tracking
) -> float:
    """Return sum_k w_k P(connected at q_k) tr Phi^-1(q_k, p_hat_{t+k|t}) (equation 4.11)."""
    arrival, sensing = delivery([posterior], [path_m], settings)
    return float(settings.weight @ (arrival * sensing)[:, 0])


def team_tracking_value(
    posteriors: Sequence[ChannelPosterior],
    paths_m: Sequence[NDArray[np.float64]],
    settings: Tracking,
) -> float:
    """:func:`tracking_value` summed over robots, each with its own knowledge of the channel."""
    arrival, sensing = delivery(posteriors, paths_m, settings)
    return float(settings.weight @ (arrival * sensing).sum(axis=1))


def delivery(
    posteriors: Sequence[ChannelPosterior],
    paths_m: Sequence[NDArray[np.float64]],  # (h, 2) of each robot
    settings: Tracking,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """P(packet arrives) and tr Phi^-1 of every step and robot; both ``(h, N)``."""
    steps = len(settings.target_m)
    if len(paths_m) != len(posteriors) or not posteriors:
        raise InputError(f"{len(posteriors)} robots and {len(paths_m)} paths", key="paths_m")
    arrival, sensing = np.empty((2, steps, len(posteriors)))
    for robot, (posterior, path) in enumerate(zip(posteriors, paths_m, strict=True)):
        places = require_places(path)
        if len(places) != steps:
            raise InputError(
                f"a path of {len(places)} places and a target predicted for {steps} steps",
                key="paths_m",
            )
        arrival[:, robot] = posterior.connectivity(places, settings.threshold_dbm)
        sensing[:, robot] = sensing_information(settings.sensor, places, settings.target_m)
    return arrival, sensing


def connectivity_derivatives(
    mean_db: Derivatives, deviation_db: Derivatives, threshold_dbm: float
) -> Derivatives:
    """P = Q((Upsilon_TH - mu) / sigma) with gradient and Hessian by position.

    With z = (mu - Upsilon_TH) / sigma: dz = (dmu - z dsigma) / sigma,
    d2z = (d2mu - z d2sigma - dz dsigma' - dsigma dz') / sigma, dP = n(z) dz and
    d2P = n(z) (d2z - z dz dz'), n the standard normal density.
    """
    rows = score_derivatives(mean_db, deviation_db, threshold_dbm).rows
    z = rows[:, 0].copy()
    # The density's slope.
    add_products(rows[:, 3:], rows[:, 1:3], (-0.5 * z)[:, None] * rows[:, 1:3])
    rows *= (np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi))[:, None]
    rows[:, 0] = score_probability(z)
    return Derivatives.of(rows)


def score_derivatives(
    mean_db: Derivatives, deviation_db: Derivatives, threshold_dbm: float
) -> Derivatives:
    """Z = (mu - Upsilon_TH) / sigma with gradient and Hessian; parameters as above."""
    by_sigma = 1.0 / deviation_db.value
    z = (mean_db.value - threshold_dbm) * by_sigma
    rows = mean_db.rows - z[:, None] * deviation_db.rows
    rows *= by_sigma[:, None]
    add_products(rows[:, 3:], rows[:, 1:3], -deviation_db.gradient * by_sigma[:, None])
    rows[:, 0] = z
    return Derivatives.of(rows)


def tracking_reward_derivatives(
    connectivity: Derivatives, sensing: Derivatives, weight: NDArray[np.float64]
) -> Derivatives:
    """w_k P tr Phi^-1 of each stage with gradient and Hessian by that stage's position."""
    # Shapes: weight (n,).
    p, s = connectivity, sensing
    # A step's weight goes with its sensing.
    sensed = weight[:, None] * s.rows
    rows = sensed[:, :1] * p.rows
    rows += p.value[:, None] * sensed
    rows[:, 0] *= 0.5
    add_products(rows[:, 3:], p.gradient, sensed[:, 1:3])
    return Derivatives.of(rows)
