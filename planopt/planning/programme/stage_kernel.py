"""The chance constraint of every stage with exact gradient and Hessian, all stages at once.

The constraint of a stage is ``mean - z_p deviation - threshold >= 0`` in dB (equation 3.2), with
mean and deviation of :mod:`planopt.planning.worth.serving_stages`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.targets.rounding import Derivatives


@dataclass(frozen=True)
class StageMargins:
    """Margins in dB with derivatives by position.

    Attributes
    ----------
    value
        ``(n,)`` dB.
    gradient
        ``(n, 2)`` dB/m.
    hessian
        ``(n, 3)`` dB/m^2: xx, xy, yy.
    """

    value: NDArray[np.float64]
    gradient: NDArray[np.float64]
    hessian: NDArray[np.float64]


def margins_of(
    mean: Derivatives,
    deviation: Derivatives,
    threshold_dbm: float,
    z: float | NDArray[np.float64],
) -> StageMargins:
    """``mean - z deviation - threshold`` of every stage, z one for all or ``(n,)``."""
    rows = mean.rows - np.reshape(z, (-1, 1)) * deviation.rows
    rows[:, 0] -= threshold_dbm
    return StageMargins(rows[:, 0], rows[:, 1:3], rows[:, 3:])


def joined(margins: StageMargins, scores: Derivatives) -> StageMargins:
    """Margins of all stages, then the scores of all: ``(2 n,)`` rows."""
    return StageMargins(
        np.concatenate([margins.value, scores.value]),
        np.concatenate([margins.gradient, scores.gradient]),
        np.concatenate([margins.hessian, scores.hessian]),
    )
