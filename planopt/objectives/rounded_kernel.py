"""The kernel and the path loss without their singularities, for derivatives.

exp(-d / beta) has a cusp at d = 0 and log d a pole. As everywhere in planning, distances to a
measurement become ``sqrt(d^2 + eps^2)`` with eps a hundredth of the decorrelation distance, and the
distance to the station ``sqrt(d^2 + MIN_DISTANCE_M^2)``. The kernel is then smaller than the exact
one by at most the share eps / beta = 0.01, at d = 0; at d = 10 eps by a twentieth of that.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import MIN_DISTANCE_M, ChannelParameters, Station
from planopt.targets.rounding import Derivatives, radial

CUSP_ROUNDING = 0.01
"""Rounding of the kernel's cusp as a share of the decorrelation distance."""


def rounded_kernel(
    offset_m: NDArray[np.float64],  # (..., 2)
    parameters: ChannelParameters,
    added_m2: NDArray[np.float64] | float = 0.0,  # (...) of each measurement
) -> Derivatives:
    """xi^2 exp(-r / beta), r = sqrt(|offset|^2 + added + eps^2), with derivatives by the offset."""
    rows = np.empty((6, *offset_m.shape[:-1]))
    soft_m2 = softened_m2(added_m2, parameters)
    fill_rounded_kernel(rows, offset_m[..., 0], offset_m[..., 1], parameters, soft_m2)
    inner = tuple(range(1, rows.ndim))
    return Derivatives(rows[0], rows[1:3].transpose(*inner, 0), rows[3:].transpose(*inner, 0))


def softened_m2(
    added_m2: NDArray[np.float64] | float, parameters: ChannelParameters
) -> NDArray[np.float64] | float:
    """Return what squared distances of the rounded kernel have more than the offsets'."""
    return added_m2 + (CUSP_ROUNDING * parameters.decorrelation_m) ** 2


def fill_rounded_kernel(
    rows: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    parameters: ChannelParameters,
    soft_m2: NDArray[np.float64] | float,
) -> None:
    """Write the kernel of offsets `x`, `y` (...) and its derivatives x, y, xx, xy, yy.

    `rows` are ``(6, ...)``; a solver asks again and again and keeps them. `soft_m2` is of
    :func:`softened_m2`.
    """
    beta = parameters.decorrelation_m
    value, by_x, by_y, by_xx, by_xy, by_yy = rows
    r = x * x
    r += y * y
    r += soft_m2
    np.sqrt(r, out=r)
    np.multiply(r, -1.0 / beta, out=value)
    np.exp(value, out=value)
    value *= parameters.shadow_std_db**2
    # -1 / (beta r); the slope is its product with the value.
    fall = np.divide(-1.0 / beta, r, out=r)
    slope = value * fall
    # -slope (1 / (beta r) + 1 / r^2)
    bend = fall * (-(beta**2))
    bend += 1.0
    bend *= fall
    bend *= slope
    np.multiply(slope, x, out=by_x)
    np.multiply(slope, y, out=by_y)
    bent = bend * x
    np.multiply(bent, y, out=by_xy)
    bent *= x
    np.add(bent, slope, out=by_xx)
    bend *= y
    bend *= y
    np.add(bend, slope, out=by_yy)


def rounded_log_distance(positions_m: NDArray[np.float64], station: Station) -> Derivatives:
    """-10 log10 sqrt(d^2 + MIN_DISTANCE_M^2) with derivatives by the position (n, 2)."""
    offset = positions_m - np.asarray(station.position_m)
    square = np.einsum("ni,ni->n", offset, offset) + (station.height_m**2 + MIN_DISTANCE_M**2)
    slope = (-10.0 / math.log(10.0)) / square
    return radial(offset, -5.0 * np.log10(square), slope, -2.0 * slope / square)
