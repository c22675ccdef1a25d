"""The additive tracking reward of every stage with exact gradient and Hessian, for solvers.

The chain rule only: where the prediction and its derivatives come from is the caller's choice.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
from planopt.targets.rounding import Derivatives

FIRST, SECOND = (0, 0, 1), (0, 1, 1)
"""Which coordinates xx, xy and yy are by."""


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
    sigma = deviation_db.value
    z = (mean_db.value - threshold_dbm) / sigma
    z1 = (mean_db.gradient - z[:, None] * deviation_db.gradient) / sigma[:, None]
    turned = z1[:, FIRST] * deviation_db.gradient[:, SECOND]
    turned += z1[:, SECOND] * deviation_db.gradient[:, FIRST]
    z2 = (mean_db.hessian - z[:, None] * deviation_db.hessian - turned) / sigma[:, None]
    density = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    return Derivatives(
        connection_probability(mean_db.value, sigma, threshold_dbm),
        density[:, None] * z1,
        density[:, None] * (z2 - z[:, None] * z1[:, FIRST] * z1[:, SECOND]),
    )


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
    crossed = p.gradient[:, FIRST] * s.gradient[:, SECOND]
    crossed += p.gradient[:, SECOND] * s.gradient[:, FIRST]
    return Derivatives(
        weight * p.value * s.value,
        weight[:, None] * (p.gradient * s.value[:, None] + p.value[:, None] * s.gradient),
        weight[:, None] * (p.hessian * s.value[:, None] + crossed + p.value[:, None] * s.hessian),
    )
