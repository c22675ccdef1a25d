"""Lengths and thresholds without their kink, for solvers: exact but within a stated width.

``|x|`` has no derivative at 0. Within `width` of 0 it is replaced by the even polynomial of degree
four that joins it with the same value, slope and curvature; elsewhere nothing changes. The
replacement is larger, by at most 3/8 of the width.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Numbers at n places with derivatives by the place.

    Attributes
    ----------
    value
        ``(...)``.
    gradient
        ``(..., 2)`` per metre.
    hessian
        ``(..., 3)`` per square metre: xx, xy, yy.
    """

    value: NDArray[np.float64]
    gradient: NDArray[np.float64]
    hessian: NDArray[np.float64]


def rounded_length(offset_m: NDArray[np.float64], width_m: float) -> Derivatives:
    """Length of `offset_m` (..., 2), rounded within `width_m` > 0 of zero, with derivatives."""
    x, y = offset_m[..., 0], offset_m[..., 1]
    value, slope, bend = _profile(np.hypot(x, y), width_m)
    return Derivatives(
        value,
        slope[..., None] * offset_m,
        np.stack([slope + bend * x * x, bend * x * y, slope + bend * y * y], axis=-1),
    )


def rounded_positive_part(
    x: NDArray[np.float64], width: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """max{0, x} with first and second derivative, rounded for ``|x| < width``.

    Larger than max{0, x} by at most 3/16 of `width`. Shapes as `x`.
    """
    value, slope, bend = _profile(np.abs(x), width)
    return 0.5 * (x + value), 0.5 * (1.0 + slope * x), 0.5 * (slope + bend * x * x)


def _profile(
    r: NDArray[np.float64], width: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """rho(r), rho' / r and (rho'' - rho' / r) / r^2: finite at 0, where the last two are needed."""
    s = np.minimum(r / width, 1.0) ** 2
    # From the width on the polynomial's values at s = 1 are 1, 1 / width and -1 / width^3.
    far = np.maximum(r, width)
    value = np.where(r < width, width * (0.375 + 0.75 * s - 0.125 * s * s), r)
    return value, (1.5 - 0.5 * s) / far, -1.0 / far**3
