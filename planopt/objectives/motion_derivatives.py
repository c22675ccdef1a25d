"""Length of a path with derivatives, for the energy of motion: it couples neighbouring places."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.targets.rounding import Derivatives, rounded_length


def path_length_derivatives(
    start_m: NDArray[np.float64], path_m: NDArray[np.float64], width_m: float
) -> PathDerivatives:
    """Sum of the lengths of all steps, each rounded within `width_m` of zero.

    Parameters
    ----------
    start_m
        ``(2,)`` where the first step begins.
    path_m
        ``(h, 2)``.
    width_m
        Over 0; a step is then longer than it is by at most 3/8 of it.
    """
    steps = rounded_length(np.diff(np.vstack([start_m, path_m]), axis=0), width_m)
    count = len(path_m)
    gradient = steps.gradient.copy()
    gradient[:-1] -= steps.gradient[1:]
    hessian = legs_curvature(steps, np.ones(count))
    return PathDerivatives(float(steps.value.sum()), gradient.ravel(), hessian)


def legs_curvature(legs: Derivatives, weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Second derivatives of a weighted sum of the lengths of steps; ``(2 h, 2 h)``.

    Parameters
    ----------
    legs
        Lengths of the h steps with derivatives by the step.
    weight
        ``(h,)``.
    """
    count = len(weight)
    blocks = (weight[:, None] * legs.hessian)[:, [0, 1, 1, 2]].reshape(count, 2, 2)
    hessian = np.zeros((count, 2, count, 2))
    k = np.arange(count)
    hessian[k, :, k] += blocks
    hessian[k[:-1], :, k[:-1]] += blocks[1:]
    hessian[k[:-1], :, k[1:]] -= blocks[1:]
    hessian[k[1:], :, k[:-1]] -= blocks[1:]
    return hessian.reshape(2 * count, 2 * count)
