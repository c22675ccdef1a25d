"""The kernel in single precision: for choosing among ways, where its cost counts most."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kernel import decayed_db2
from planopt.channel.parameters import ChannelParameters


def single_kernel(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    parameters: ChannelParameters,
    blur_m2: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distances of `a` (n, 2) from `b` (m, 2) and covariances of shadowing; both ``(n, m)``.

    Coordinates near 3e6 keep their digits: what is rounded are offsets from the middle of `a`.
    `blur_m2` (m,) is added to the squares.
    """
    middle = a.mean(axis=0)
    from_m, to_m = (a - middle).astype(np.float32), (b - middle).astype(np.float32)
    distance = from_m[:, :1] - to_m[:, 0]
    distance *= distance
    dy = from_m[:, 1:] - to_m[:, 1]
    dy *= dy
    distance += dy
    if blur_m2 is not None:
        distance += blur_m2.astype(np.float32)
    np.sqrt(distance, out=distance)
    return distance, decayed_db2(distance.copy(), parameters)
