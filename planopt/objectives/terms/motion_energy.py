"""The term ``motion_energy``: energy of motion, subtracted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.terms.context import NearPath, Paths, StepContext
from planopt.objectives.terms.term import Structure, Term
from planopt.objectives.told_batch import Pull, ToldBatch, pull_of_legs
from planopt.targets.rounding import Derivatives, rounded_length


def path_length_derivatives(
    start_m: NDArray[np.float64], path_m: NDArray[np.float64], width_m: float
) -> PathDerivatives:
    """Sum of the lengths of all steps, each rounded within `width_m` of zero."""
    # Shapes: start_m (2,); path_m (h, 2).
    steps = rounded_length(np.diff(np.vstack([start_m, path_m]), axis=0), width_m)
    count = len(path_m)
    gradient = steps.gradient.copy()
    gradient[:-1] -= steps.gradient[1:]
    hessian = legs_curvature(steps, np.ones(count))
    return PathDerivatives(float(steps.value.sum()), gradient.ravel(), hessian)


def legs_curvature(legs: Derivatives, weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Second derivatives of a weighted sum of the lengths of steps; ``(2 h, 2 h)``."""
    # Shapes: weight (h,).
    count = len(weight)
    blocks = (weight[:, None] * legs.hessian)[:, [0, 1, 1, 2]].reshape(count, 2, 2)
    hessian = np.zeros((count, 2, count, 2))
    k = np.arange(count)
    hessian[k, :, k] += blocks
    hessian[k[:-1], :, k[:-1]] += blocks[1:]
    hessian[k[:-1], :, k[1:]] -= blocks[1:]
    hessian[k[1:], :, k[:-1]] -= blocks[1:]
    return hessian.reshape(2 * count, 2 * count)


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

    def value(self, at: StepContext, path_m: NDArray[np.float64]) -> float:
        """Return minus the energy of a path."""
        lengths = np.linalg.norm(np.diff(np.vstack([at.position_m, path_m]), axis=0), axis=1)
        return -float(self._spent_j(lengths, at.standstill_m, at.step_s).sum())

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return minus the energy of each path."""
        return -self._spent_j(paths.legs_m, paths.at.standstill_m, paths.at.step_s).sum(axis=1)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return minus the energy of the length; that of moving at all hardly depends on where."""
        length = path_length_derivatives(path.at.position_m, path.places_m, path.rounding_m)
        scale = -self.per_metre_j_m
        return PathDerivatives(
            scale * length.value, scale * length.gradient, scale * length.hessian
        )

    def slope(self, at: StepContext, told: ToldBatch, station: ChannelPosterior) -> Pull:
        """Return derivatives by the lengths of the steps."""
        by_length = np.full(told.batch.shape, -self.per_metre_j_m)
        return pull_of_legs(at.position_m, told.batch.ways_m, by_length)

    def move_reward(self, lengths_m: NDArray[np.float64], step_s: float) -> NDArray[np.float64]:
        """Return minus the energy of each move."""
        return -self._spent_j(lengths_m, 0.0, step_s)

    def _spent_j(
        self, lengths_m: NDArray[np.float64], standstill_m: float, step_s: float
    ) -> NDArray[np.float64]:
        """Energy of each step (...); one no longer than `standstill_m` draws no power (4.12)."""
        moving_s = np.where(lengths_m > standstill_m, step_s, 0.0)
        return self.per_metre_j_m * lengths_m + self.power_w * moving_s
