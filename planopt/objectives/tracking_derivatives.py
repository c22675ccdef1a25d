"""The additive tracking reward of every stage with exact gradient and Hessian, for solvers.

The chain rule only: where the prediction and its derivatives come from is the caller's choice.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import score_probability
from planopt.targets.rounding import Derivatives, add_products


def connectivity_derivatives(
    mean_db: Derivatives, deviation_db: Derivatives, threshold_dbm: float
) -> Derivatives:
    """P = Q((Upsilon_TH - mu) / sigma) with gradient and Hessian by position.

    With z = (mu - Upsilon_TH) / sigma: dz = (dmu - z dsigma) / sigma,
    d2z = (d2mu - z d2sigma - dz dsigma' - dsigma dz') / sigma, dP = n(z) dz and
    d2P = n(z) (d2z - z dz dz'), n the standard normal density.

    Parameters
    ----------
    mean_db, deviation_db
        mu and sigma > 0 at n places, with derivatives.
    threshold_dbm
        Upsilon_TH.
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
    """w_k P tr Phi^-1 of each stage with gradient and Hessian by that stage's position.

    Parameters
    ----------
    connectivity
        P at n places, from :func:`connectivity_derivatives`.
    sensing
        1 / g at them, from :func:`planopt.targets.sensor.sensing_derivatives`.
    weight
        ``(n,)`` w_k.
    """
    p, s = connectivity, sensing
    # A step's weight goes with its sensing.
    sensed = weight[:, None] * s.rows
    rows = sensed[:, :1] * p.rows
    rows += p.value[:, None] * sensed
    rows[:, 0] *= 0.5
    add_products(rows[:, 3:], p.gradient, sensed[:, 1:3])
    return Derivatives.of(rows)
