"""Kernel and path loss with derivatives, their cusps rounded, for solvers only.

exp(-d / beta) has a cusp at d = 0 and log d a pole. As everywhere in planning, distances to a
measurement become ``sqrt(d^2 + eps^2)`` with eps a hundredth of the decorrelation distance, and the
distance to the station ``sqrt(d^2 + MIN_DISTANCE_M^2)``. The kernel is then smaller than the exact
one by at most the share eps / beta = 0.01, at d = 0; at d = 10 eps by a twentieth of that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.path_loss import MIN_DISTANCE_M
from planopt.targets.rounding import Derivatives

CUSP_ROUNDING = 0.01
"""Rounding of the kernel's cusp as a share of the decorrelation distance."""


def rounded_kernel(
    offset_m: NDArray[np.float64],
    parameters: ChannelParameters,
    blur_m2: NDArray[np.float64] | float = 0.0,
) -> Derivatives:
    """xi^2 exp(-r / beta), r = sqrt(|offset|^2 + blur + eps^2), with derivatives by the offset.

    Parameters
    ----------
    offset_m
        ``(..., 2)``.
    parameters
        The channel's parameters.
    blur_m2
        ``(...)`` of position errors.
    """
    beta = parameters.decorrelation_m
    x, y = offset_m[..., 0], offset_m[..., 1]
    r = np.sqrt(x * x + y * y + blur_m2 + (CUSP_ROUNDING * beta) ** 2)
    value = parameters.shadow_std_db**2 * np.exp(r / -beta)
    slope = -value / (beta * r)
    bend = -slope * (1.0 / (beta * r) + 1.0 / (r * r))
    gradient, hessian = np.empty((*r.shape, 2)), np.empty((*r.shape, 3))
    gradient[..., 0], gradient[..., 1] = slope * x, slope * y
    bent = bend * x
    hessian[..., 0], hessian[..., 1] = bent * x + slope, bent * y
    hessian[..., 2] = bend * y * y + slope
    return Derivatives(value, gradient, hessian)


def rounded_log_distance(positions_m: NDArray[np.float64], station: Station) -> Derivatives:
    """-10 log10 sqrt(d^2 + MIN_DISTANCE_M^2) with derivatives by the position (n, 2)."""
    offset = positions_m - np.asarray(station.position_m)
    x, y = offset[:, 0], offset[:, 1]
    square = x * x + y * y + station.height_m**2 + MIN_DISTANCE_M**2
    slope = -10.0 / np.log(10.0) / square
    bend = -2.0 * slope / square
    return Derivatives(
        -5.0 * np.log10(square),
        slope[:, None] * offset,
        np.stack([slope + bend * x * x, bend * x * y, slope + bend * y * y], axis=1),
    )
