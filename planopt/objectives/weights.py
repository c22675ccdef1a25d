"""A check of weights: of goals, of places on a map, of steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError


def require_weights(weight: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """`weight` as ``(count,)`` floats from 0 on, or an InputError."""
    found = np.asarray(weight, dtype=np.float64)
    if found.shape != (count,) or not (np.isfinite(found).all() and (found >= 0.0).all()):
        raise InputError(
            f"{count} places need as many weights from 0 on, not {found.shape}", key="weight"
        )
    return found
