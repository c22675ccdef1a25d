"""The term ``motion_energy``: energy of motion, subtracted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.objectives.moments import Pull, pull_of_lengths
from planopt.objectives.path_derivatives import PathDerivatives, by_lengths
from planopt.objectives.terms.context import NearPath, Paths, TermContext
from planopt.objectives.terms.term import Structure, Term
from planopt.targets.rounding import rounded_length


@dataclass(frozen=True)
class MotionEnergyTerm(Term):
    """Energy of motion, a cost: k1 a metre and k2 a second while moving, in joules."""

    per_metre_j_m: Annotated[float, Field(ge=0, le=1e9, description="k1 in J/m.")]
    power_w: Annotated[float, Field(ge=0, le=1e9, description="k2 in W while moving.")] = 0.0

    kind: ClassVar[str] = "motion_energy"
    summary: ClassVar[str] = "Spare energy."
    task: ClassVar[str | None] = None

    @property
    def structure(self) -> Structure:
        """A step couples its two ends."""
        return "chain"

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return minus the energy of a path."""
        lengths = np.linalg.norm(np.diff(np.vstack([at.position_m, path_m]), axis=0), axis=1)
        return -float(self._spent_j(lengths, at.standstill_m, at.step_s).sum())

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return minus the energy of each path."""
        return -self._spent_j(paths.legs_m, paths.at.standstill_m, paths.at.step_s).sum(axis=1)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return minus the energy of the length; that of moving at all hardly depends on where."""
        offsets = np.diff(np.vstack([path.at.position_m, path.places_m]), axis=0)
        lengths = rounded_length(offsets, path.rounding_m)
        each = np.full(len(offsets), -self.per_metre_j_m)
        return PathDerivatives(float(each @ lengths.value), *by_lengths(lengths, each))

    def slope(self, paths: Paths, number: int) -> Pull:
        """Return derivatives by the lengths of the steps."""
        by_length = np.full(paths.shape, -self.per_metre_j_m)
        return pull_of_lengths(paths.at.position_m, paths.ways_m, by_length)

    def move_reward(self, lengths_m: NDArray[np.float64], step_s: float) -> NDArray[np.float64]:
        """Return minus the energy of each move."""
        return -self._spent_j(lengths_m, 0.0, step_s)

    def _spent_j(
        self, lengths_m: NDArray[np.float64], standstill_m: float, step_s: float
    ) -> NDArray[np.float64]:
        """Energy of each step (...); one no longer than `standstill_m` draws no power (4.12)."""
        moving_s = np.where(lengths_m > standstill_m, step_s, 0.0)
        return self.per_metre_j_m * lengths_m + self.power_w * moving_s
