"""Path loss by generalised least squares from products of whitened columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import ChannelParameters

WEAK_THETA_DEVIATION = (20.0, 1.0)
"""Prior deviation of K_PL (dB) and n_PL, used only where the measurements do not identify theta."""

MAX_INFORMATION_CONDITION = 1e10
"""Theta counts as identified while the condition number of its information, in units of
`WEAK_THETA_DEVIATION`, is below this."""


def theta_estimate(
    parameters: ChannelParameters, products: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimate theta and its covariance M (equation 1.7).

    Parameters
    ----------
    parameters
        Its theta, theta_0, is the centre of the weak prior.
    products
        ``(3, 3)`` C' U^-1 C of the columns C = [y - Gamma theta_0, Gamma]: about theta_0, where
        the digits are.
    """
    # In units of the weak prior.
    unit = np.array(WEAK_THETA_DEVIATION)
    information = unit[:, None] * products[1:, 1:] * unit
    spread = np.linalg.eigvalsh(information)
    if spread[0] * MAX_INFORMATION_CONDITION <= spread[1]:
        information += np.eye(2)
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    moved = unit * (covariance @ (unit * products[1:, 0]))
    theta = np.array([parameters.k_pl_db, parameters.n_pl]) + moved
    return theta, unit[:, None] * covariance * unit
