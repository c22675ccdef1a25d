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
    value, slope, bend = _profile(np.hypot(offset_m[..., 0], offset_m[..., 1]), width_m)
    return Derivatives(value, slope[..., None] * offset_m, radial_hessian(offset_m, slope, bend))


def radial_hessian(
    offset_m: NDArray[np.float64], slope: NDArray[np.float64], bend: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``slope I + bend x x'`` of offsets x (..., 2), as xx, xy, yy (..., 3)."""
    x, y = offset_m[..., 0], offset_m[..., 1]
    hessian = np.empty((*x.shape, 3))
    bent = bend[..., None] * offset_m
    hessian[..., :2] = bent * offset_m[..., :1]
    hessian[..., 0] += slope
    np.multiply(bent[..., 1], y, out=hessian[..., 2])
    hessian[..., 2] += slope
    return hessian


def add_products(
    hessian: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> None:
    """Add a b' + b a' to `hessian` (..., 3), given as xx, xy, yy; `a` and `b` are (..., 2)."""
    crossed = a * b
    crossed += crossed
    hessian[..., ::2] += crossed
    hessian[..., 1] += a[..., 0] * b[..., 1]
    hessian[..., 1] += a[..., 1] * b[..., 0]


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
    if r.min(initial=np.inf) >= width:
        inverse = 1.0 / r
        return r, inverse, -inverse * inverse * inverse
    # From the width on the polynomial's values at s = 1 are 1, 1 / width and -1 / width^3.
    far = np.maximum(r, width)
    s = r / far
    s *= s
    value = np.where(r < width, width * (0.375 + 0.75 * s - 0.125 * s * s), r)
    return value, (1.5 - 0.5 * s) / far, -1.0 / (far * far * far)
