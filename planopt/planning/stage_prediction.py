"""Predicted power and deviation of every stage with exact derivatives, all stages at once.

From the measurements nearest to each stage (design 4.1) and with the uncertainty of theta counted.
Two things differ from the exact posterior, both only here: the kernel's cusp at a measured position
is rounded (``sqrt(d^2 + eps^2)``, eps a hundredth of the decorrelation distance), and fewer
measurements are used. The verifier uses neither.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.neighbours import NeighbourModel
from planopt.channel.path_loss import MIN_DISTANCE_M
from planopt.objectives.rounded_kernel import CUSP_ROUNDING
from planopt.targets.rounding import Derivatives


def stage_prediction(
    model: NeighbourModel, positions_m: NDArray[np.float64]
) -> tuple[Derivatives, Derivatives]:
    """Mean and deviation of stage k at ``positions_m[k]``, from ``model``'s k-th neighbour set.

    Parameters
    ----------
    model
        Neighbour sets of the n stages.
    positions_m
        ``(n, 2)``.
    """
    parameters = model.parameters
    variance = parameters.shadow_std_db**2
    beta = parameters.decorrelation_m
    dx = positions_m[:, None, 0] - model.positions_m[:, :, 0]
    dy = positions_m[:, None, 1] - model.positions_m[:, :, 1]
    r = np.sqrt(dx * dx + dy * dy + model.blur_m2 + (CUSP_ROUNDING * beta) ** 2)
    phi = variance * np.exp(-r / beta)
    slope = -phi / (beta * r)
    bend = phi / (beta * r) ** 2 + phi / (beta * r**3)
    # Stacked: phi, phi_x, phi_y, phi_xx, phi_xy, phi_yy, each (n, m).
    derivatives = np.stack(
        [
            phi,
            slope * dx,
            slope * dy,
            bend * dx * dx + slope,
            bend * dx * dy,
            bend * dy * dy + slope,
        ],
        axis=2,
    )
    solved = model.precision @ derivatives[:, :, :3]
    residual_weights = model.weights - model.trend @ model.theta
    left = np.concatenate([residual_weights[:, :, None], solved[:, :, :1], model.trend], axis=2)
    products = left.transpose(0, 2, 1) @ derivatives  # (n, 4, 6)

    gamma = _path_loss_derivatives(model, positions_m)  # (n, 6): of -10 log10 d
    mean = model.theta[1] * gamma + products[:, 0]
    mean[:, 0] += model.theta[0]
    # b = gamma - A' phi and its derivatives, (n, 2, 6).
    b = -products[:, 2:4]
    b[:, 0, 0] += 1.0
    b[:, 1] += gamma
    mb = model.theta_covariance @ b[:, :, :3]
    s = np.empty_like(mean)
    s[:, 0] = variance + parameters.multipath_std_db**2 - products[:, 1, 0]
    s[:, 0] += (b[:, :, 0] * mb[:, :, 0]).sum(1)
    s[:, 1:3] = -2.0 * products[:, 1, 1:3]
    s[:, 1:3] += 2.0 * np.einsum("ni,nij->nj", mb[:, :, 0], b[:, :, 1:3])
    cross = derivatives[:, :, 1:3].transpose(0, 2, 1) @ solved[:, :, 1:3]
    cross_b = b[:, :, 1:3].transpose(0, 2, 1) @ mb[:, :, 1:3]
    s[:, 3:] = -2.0 * products[:, 1, 3:]
    s[:, 3:] += 2.0 * np.einsum("ni,nij->nj", mb[:, :, 0], b[:, :, 3:])
    first, second = (0, 0, 1), (0, 1, 1)
    s[:, 3:] += 2.0 * (cross_b - cross)[:, first, second]

    deviation = np.sqrt(np.maximum(s[:, 0], np.finfo(float).tiny))
    d1 = s[:, 1:3] / (2.0 * deviation[:, None])
    d2 = s[:, 3:] / (2.0 * deviation[:, None]) - d1[:, first] * d1[:, second] / deviation[:, None]
    return (
        Derivatives(mean[:, 0], mean[:, 1:3], mean[:, 3:]),
        Derivatives(deviation, d1, d2),
    )


def _path_loss_derivatives(
    model: NeighbourModel, positions_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Value, gradient and Hessian of -10 log10 d, d rounded below at the least distance; (n, 6)."""
    station = model.parameters.station
    x = positions_m[:, 0] - station.position_m[0]
    y = positions_m[:, 1] - station.position_m[1]
    square = x * x + y * y + station.height_m**2 + MIN_DISTANCE_M**2
    scale = -10.0 / np.log(10.0)
    return np.stack(
        [
            0.5 * scale * np.log(square),
            scale * x / square,
            scale * y / square,
            scale * (1.0 / square - 2.0 * x * x / square**2),
            scale * (-2.0 * x * y / square**2),
            scale * (1.0 / square - 2.0 * y * y / square**2),
        ],
        axis=1,
    )
