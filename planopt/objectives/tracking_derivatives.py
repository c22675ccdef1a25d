"""The additive tracking reward of every stage with exact gradient and Hessian, for solvers.

The chain rule only: where the prediction and its derivatives come from is the caller's choice.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
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
    sigma = deviation_db.value
    z = (mean_db.value - threshold_dbm) / sigma
    by_sigma, across = (1.0 / sigma)[:, None], z[:, None]
    z1 = mean_db.gradient - across * deviation_db.gradient
    z1 *= by_sigma
    z2 = mean_db.hessian - across * deviation_db.hessian
    # The turned parts, and those of the density's slope, are products with z1.
    turned = deviation_db.gradient * by_sigma
    turned += (0.5 * across) * z1
    z2 *= by_sigma
    add_products(z2, z1, -turned)
    density = (np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi))[:, None]
    z1 *= density
    z2 *= density
    return Derivatives(connection_probability(mean_db.value, sigma, threshold_dbm), z1, z2)


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
    sensed, felt = (weight * s.value)[:, None], (weight * p.value)[:, None]
    gradient = sensed * p.gradient
    gradient += felt * s.gradient
    hessian = sensed * p.hessian
    hessian += felt * s.hessian
    add_products(hessian, p.gradient, weight[:, None] * s.gradient)
    return Derivatives(felt[:, 0] * s.value, gradient, hessian)
