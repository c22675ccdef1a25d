"""Tracking: information that reaches the station, summed over steps, with derivatives.

A packet counts with the probability that it arrives. The sum over steps and robots needs no joint
law, so that a dynamic programme can plan with it; :mod:`planopt.objectives.tracking_recourse`
follows the station's filter instead.

Predictions and their derivatives come from the caller; this module applies the chain rule.
"""

from __future__ import annotations

import math
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


def tracking_value(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], settings: Tracking
) -> float:
    """Return sum_k w_k P(connected at q_k) tr Phi^-1(q_k, p_hat_{t+k|t}) (equation 4.11)."""
    places = require_places(path_m)
    if len(places) != len(settings.target_m):
        raise InputError(
            f"a path of {len(places)} places and a target predicted for "
            f"{len(settings.target_m)} steps",
            key="path_m",
        )
    arrival = posterior.connectivity(places, settings.threshold_dbm)
    sensing = sensing_information(settings.sensor, places, settings.target_m)
    return float(settings.weight @ (arrival * sensing))


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
