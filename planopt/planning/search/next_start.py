"""Whether one more start is worth a polish once others have been polished."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.search.start_search import Start

CLOSE_SHARE = 0.01
"""Ways that have climbed gain a few percent more when polished, all about as much: one that is
behind by more than this share of the best seldom ends ahead of it."""

MERGED_STEPS = 2.0
"""A start that is nowhere farther than so many longest steps from a polished path leads to it."""


def is_worth_following(
    start: Start, best: Start, polished_m: Sequence[NDArray[np.float64]], longest_m: float
) -> bool:
    """Whether `start`, that has climbed, may lead to something better.

    Parameters
    ----------
    start, best
        The one in question, and the best of all starts.
    polished_m
        Paths (N, 2) that have been polished.
    longest_m
        Longest step.
    """
    if start.worth < best.worth - CLOSE_SHARE * abs(best.worth):
        return False
    return all(np.abs(start.path_m - path).max() > MERGED_STEPS * longest_m for path in polished_m)
