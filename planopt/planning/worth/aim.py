"""What the worth of a plan depends on beside the belief: the target, and where to steer to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.worth.pending import NOTHING_PENDING, Pending


@dataclass(frozen=True, eq=False)
class Aim:
    """External inputs of one plan's objective: expected target and steering path, if any.

    Attributes
    ----------
    target_m
        ``(N, 2)`` where the target was expected at the end of each step; None without target.
    steering_turns_m
        ``(m, 2)`` the way that the two-layer form steered along: where the robot was, where the
        way turns, and its end; None if it did not steer.
    information
        ``(4, 4)`` J_{t|t} of the station's filter then; None without target.
    pending
        Where the other robots measure, as the plan counts it.
    """

    target_m: NDArray[np.float64] | None = None
    steering_turns_m: NDArray[np.float64] | None = None
    information: NDArray[np.float64] | None = None
    pending: Pending = NOTHING_PENDING
