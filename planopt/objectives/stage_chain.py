"""The chain rule from numbers of single stages to the path: for values of such numbers.

Connectivity, sensing, mean and deviation of a stage depend on its own place alone. A value of all
of them, a filter's or a user's, has derivatives by these numbers; here they become derivatives by
the path.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.batch_derivatives import PathDerivatives, add_own_blocks
from planopt.targets.rounding import Derivatives


def chained(
    value: float,
    gradient: NDArray[np.float64],  # (h, c) by the numbers
    hessian: NDArray[np.float64],  # (h, c, h, c) by the numbers
    inputs: Sequence[Derivatives],
) -> PathDerivatives:
    """Derivatives by the 2 h coordinates of a value of c numbers of each stage."""
    steps = len(gradient)
    slopes = np.stack([each.gradient for each in inputs], axis=1)
    bent = np.stack([each.hessian for each in inputs], axis=1)
    inner = np.einsum("kcld,ldb->kclb", hessian, slopes)
    found = np.einsum("kclb,kca->kalb", inner, slopes).reshape(2 * steps, 2 * steps)
    add_own_blocks(found, np.einsum("kc,kcx->kx", gradient, bent))
    return PathDerivatives(value, np.einsum("kc,kca->ka", gradient, slopes).ravel(), found)
