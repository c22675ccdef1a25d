"""Objective value, connectivity margins and bounded sum of a path, with exact derivatives.

The margin of a stage is ``mean - z_p * standard deviation - threshold`` in dB (equation 3.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.targets.rounding import Derivatives


def margins_of(
    mean: Derivatives,
    deviation: Derivatives,
    threshold_dbm: float,
    z: float | NDArray[np.float64],
) -> Derivatives:
    """Return the margin in dB of every stage; z is a scalar or ``(N,)``."""
    rows = mean.rows - np.reshape(z, (-1, 1)) * deviation.rows
    rows[:, 0] -= threshold_dbm
    return Derivatives.of(rows)


@dataclass(frozen=True)
class PathValue:
    """Value and derivatives of a scalar function of a path of N steps."""

    value: float
    gradient: NDArray[np.float64]  # (N, 2)
    # (N, 3), xx, xy and yy of each stage, if stagewise. (7 N - 4,) for a chain: these, then xx, xy,
    # yx and yy between each stage and the next. Else (2 N, 2 N).
    hessian: NDArray[np.float64]


@dataclass(frozen=True)
class Evaluation:
    """Objective value of one path, and its bounded margins or sum."""

    value: PathValue
    margins: Derivatives | None  # Margins of the N stages
    total: PathValue | None = None  # Sum over stages with Hessian (N, 3)


EvaluatePath = Callable[[NDArray[np.float64]], Evaluation]
"""Function from positions (N, 2) to their evaluation."""


def remembering(evaluate: EvaluatePath) -> EvaluatePath:
    """Return `evaluate` with a cache for the last path.

    Solvers request value, rows and derivatives at the same point in separate calls.
    """
    key, last = b"", None

    def remembered(places_m: NDArray[np.float64]) -> Evaluation:
        nonlocal key, last
        requested = places_m.tobytes()
        if last is None or requested != key:
            key, last = requested, evaluate(places_m)
        return last

    return remembered


class ValueSource:
    """Evaluation that the callbacks of a built solver read; each solve sets its own."""

    def __init__(self) -> None:
        self._evaluate: EvaluatePath | None = None

    def use(self, evaluate: EvaluatePath) -> None:
        """Set the evaluation function and clear its cache."""
        self._evaluate = remembering(evaluate)

    def __call__(self, flat: NDArray[np.float64]) -> Evaluation:
        """Return the evaluation at positions flattened to (2 N,)."""
        if self._evaluate is None:
            raise AssertionError("a solver was called before its value was set")
        return self._evaluate(flat.reshape(-1, 2))
