"""What the worth of a plan depends on beside the belief: the target, and where to steer to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Aim:
    """What one plan was made for.

    Attributes
    ----------
    target_m
        ``(N, 2)`` where the target was expected at the end of each step; None without target.
    steering_m
        ``(2,)`` where the two-layer form steered to; None if it did not.
    information
        ``(4, 4)`` J_{t|t} of the station's filter then; None without target.
    """

    target_m: NDArray[np.float64] | None
    steering_m: NDArray[np.float64] | None
    information: NDArray[np.float64] | None = None
