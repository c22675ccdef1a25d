"""Evaluations that the callbacks of a built solver ask for, exact and memoised by point.

The constraint of a stage is ``mean - z_p deviation - threshold >= 0`` in dB (equation 3.2), with
mean and deviation of :mod:`planopt.objectives.stage_power`. A value of the whole path comes
with derivatives by all of its positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.targets.rounding import Derivatives


@dataclass(frozen=True)
class StageMargins:
    """Margins in dB with derivatives by position."""

    value: NDArray[np.float64]  # (n,) dB
    gradient: NDArray[np.float64]  # (n, 2) dB/m
    hessian: NDArray[np.float64]  # (n, 3) dB/m^2: xx, xy, yy


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


@dataclass(frozen=True)
class PathValue:
    """A value of a path of N steps with derivatives by its positions."""

    value: float  # What the path is worth
    gradient: NDArray[np.float64]  # (N, 2)
    # (N, 3), xx, xy and yy of each stage, if stagewise. (7 N - 4,) if a chain: these, and xx, xy,
    # yx and yy between each stage and the next. Else (2 N, 2 N).
    hessian: NDArray[np.float64]


@dataclass(frozen=True)
class Evaluation:
    """Value, connectivity margins and sum of one path; the last two only where bounded.

    The sum is one over stages, with a Hessian ``(N, 3)``.
    """

    value: PathValue
    margins: StageMargins | None
    total: PathValue | None = None


EvaluatePath = Callable[[NDArray[np.float64]], Evaluation]
"""From positions (N, 2) to what they are worth."""


def remembering(evaluate: EvaluatePath) -> EvaluatePath:
    """`evaluate`, asked once for a path that comes several times in a row.

    A start is asked for by its bound, by the programme and by the solver, which asks for value,
    rows and their derivatives in separate calls; its last point is asked for once more.
    """
    key, last = b"", None

    def remembered(places_m: NDArray[np.float64]) -> Evaluation:
        nonlocal key, last
        asked = places_m.tobytes()
        if last is None or asked != key:
            key, last = asked, evaluate(places_m)
        return last

    return remembered


class ValueSource:
    """The functions that a built solver's callbacks evaluate: exchanged for each solve."""

    def __init__(self) -> None:
        self._evaluate: EvaluatePath | None = None

    def use(self, evaluate: EvaluatePath) -> None:
        """Evaluate this from now on, each point once."""
        self._evaluate = remembering(evaluate)

    def at(self, flat: NDArray[np.float64]) -> PathValue:
        """Value at positions flattened to (2 N,)."""
        return self._at(flat).value

    def margins_at(self, flat: NDArray[np.float64]) -> StageMargins:
        """Margins at positions flattened to (2 N,)."""
        margins = self._at(flat).margins
        if margins is None:
            raise AssertionError("a bounded programme was given no margins")
        return margins

    def total_at(self, flat: NDArray[np.float64]) -> PathValue:
        """The bounded sum at positions flattened to (2 N,)."""
        total = self._at(flat).total
        if total is None:
            raise AssertionError("a programme that bounds a sum was given none")
        return total

    def _at(self, flat: NDArray[np.float64]) -> Evaluation:
        if self._evaluate is None:
            raise AssertionError("a solver was called before its value was set")
        return self._evaluate(flat.reshape(-1, 2))
