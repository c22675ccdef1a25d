"""The covariance of shadowing: xi^2 exp(-d / beta)."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import ChannelParameters

Real = TypeVar("Real", np.float32, np.float64)


def pairwise_distance_m(
    a: NDArray[np.float64], b: NDArray[np.float64], blur_m2: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Distances between every row of `a` (..., n, 2) and of `b` (..., m, 2); (..., n, m).

    By differences, not by the expanded square, so that coordinates near 3e6 keep their digits.
    `blur_m2`, which broadcasts to the result, is added to the squares (position errors).
    """
    dx = a[..., :, None, 0] - b[..., None, :, 0]
    dy = a[..., :, None, 1] - b[..., None, :, 1]
    dx *= dx
    dy *= dy
    dx += dy
    if blur_m2 is not None:
        dx += blur_m2
    return np.sqrt(dx, out=dx)


def shadow_covariance_db2(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    parameters: ChannelParameters,
    blur_m2: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Covariance of shadowing between positions `a` (..., n, 2) and `b` (..., m, 2), in dB^2.

    Leading axes are batches; the result is (..., n, m). `blur_m2` as in
    :func:`pairwise_distance_m`.
    """
    return decayed_db2(pairwise_distance_m(a, b, blur_m2), parameters)


def decayed_db2(distance_m: NDArray[Real], parameters: ChannelParameters) -> NDArray[Real]:
    """Covariance of shadowing over distances, of any shape and precision, which it replaces."""
    covariance = distance_m
    covariance *= -1.0 / parameters.decorrelation_m
    np.exp(covariance, out=covariance)
    covariance *= parameters.shadow_std_db**2
    return covariance
