"""The covariance of shadowing: xi^2 exp(-d / beta)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import ChannelParameters


def pairwise_distance_m(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances between every row of `a` (n, 2) and of `b` (m, 2); (n, m).

    By differences, not by the expanded square, so that coordinates near 3e6 keep their digits.
    """
    dx = a[:, None, 0] - b[None, :, 0]
    dy = a[:, None, 1] - b[None, :, 1]
    return np.sqrt(dx * dx + dy * dy)


def shadow_covariance_db2(
    a: NDArray[np.float64], b: NDArray[np.float64], parameters: ChannelParameters
) -> NDArray[np.float64]:
    """Covariance of shadowing between positions `a` (n, 2) and `b` (m, 2), in dB^2; (n, m)."""
    distance = pairwise_distance_m(a, b)
    return parameters.shadow_std_db**2 * np.exp(-distance / parameters.decorrelation_m)
