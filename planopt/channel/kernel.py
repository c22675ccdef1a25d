"""The covariance of shadowing: xi^2 exp(-d / beta)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import ChannelParameters


def pairwise_distance_m(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances between every row of `a` (..., n, 2) and of `b` (..., m, 2); (..., n, m).

    By differences, not by the expanded square, so that coordinates near 3e6 keep their digits.
    """
    dx = a[..., :, None, 0] - b[..., None, :, 0]
    dy = a[..., :, None, 1] - b[..., None, :, 1]
    dx *= dx
    dy *= dy
    dx += dy
    return np.sqrt(dx, out=dx)


def shadow_covariance_db2(
    a: NDArray[np.float64], b: NDArray[np.float64], parameters: ChannelParameters
) -> NDArray[np.float64]:
    """Covariance of shadowing between positions `a` (..., n, 2) and `b` (..., m, 2), in dB^2.

    Leading axes are batches; the result is (..., n, m).
    """
    covariance = pairwise_distance_m(a, b)
    covariance /= -parameters.decorrelation_m
    np.exp(covariance, out=covariance)
    covariance *= parameters.shadow_std_db**2
    return covariance
