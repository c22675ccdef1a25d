"""Theta = (K_PL, n_PL) by maximum likelihood or least squares, and what one measurement adds.

Given xi, beta and omega, theta is estimated from correlated powers y = Gamma theta + e with
E e e' = U. Maximum likelihood is generalised least squares, M_ML = (Gamma' U^-1 Gamma)^-1, the
smallest error of an unbiased estimate; ordinary least squares has (G'G)^-1 G'UG (G'G)^-1, which is
never smaller.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kriging import kriging_terms
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.parameters import ChannelParameters
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior, condition
from planopt.errors import InputError

Estimator = Literal["ml", "ls"]


@dataclass(frozen=True, eq=False)
class ThetaEstimate:
    """Path loss."""

    theta: NDArray[np.float64]  # (2,) (K_PL in dBm, n_PL)
    covariance: NDArray[np.float64]  # (2, 2) of its error under the channel's xi, beta and omega


def estimate_theta(
    measurements: Measurements | Table, parameters: ChannelParameters, how: Estimator = "ml"
) -> ThetaEstimate:
    """Estimate path loss for given xi, beta and omega (equations 1.7 and 1.9).

    Where the measurements do not identify theta, a weak prior about the theta of `parameters`
    stands in (:data:`planopt.channel.posterior.WEAK_THETA_DEVIATION`), and the covariance is that
    of the estimate with it.

    Parameters
    ----------
    measurements
        Any number. Censored ones are Gaussian sites to ``ml``; ``ls`` leaves them out.
    parameters
        The channel; its theta is not used but as said.
    how
        ``ml``: generalised least squares. ``ls``: ordinary least squares.

    Raises
    ------
    InputError
        There is no such estimator.
    """
    measurements = as_measurements(measurements)
    if how not in get_args(Estimator):
        raise InputError(f"{how!r} is no estimator", key="how", remedy="use ml or ls")
    rule = "estimated" if how == "ml" else "least_squares"
    posterior = condition(parameters, measurements, theta=rule)
    return ThetaEstimate(posterior.theta, posterior.theta_covariance)


def ml_covariance_after(
    posterior: ChannelPosterior, position_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """M_ML after one more measurement at `position_m` (2,), whatever its power; ``(2, 2)``.

    M_{t+1}^-1 = M_t^-1 + varphi varphi' / sigma^2 (equation 1.10), with varphi = gamma - Gamma'
    U^-1 phi and sigma^2 = xi^2 + omega^2 - phi' U^-1 phi; written so that nothing is inverted.
    """
    if posterior.theta_rule != "estimated":
        raise InputError(
            f"the recursion is that of an estimated theta, not of a {posterior.theta_rule} one",
            key="theta",
        )
    place = require_places(np.asarray(position_m)[None])
    terms = kriging_terms(posterior, place)
    before = posterior.theta_covariance
    moved = before @ terms.trend[0]
    return before - np.outer(moved, moved) / (terms.variance_db2[0] + terms.trend[0] @ moved)
