"""The structure that a solver for any smooth value of a path is built for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.terms.term import Structure
from planopt.planning.programme.motion_rows import MotionShape


@dataclass(frozen=True)
class PathShape:
    """The structure of a programme over a path.

    Attributes
    ----------
    horizon, lines
        N, and separating lines a segment.
    structure
        Which stages the value couples.
    bounded, summed
        Whether connectivity is bounded at stages, or a sum over them is; not both.
    motion
        Of the rows of the robot's dynamics; None for the single integrator.
    slacked
        Whether what is bounded may be missed by slacks.
    charged
        Whether the way to a goal is charged, of a robot with dynamics.
    """

    horizon: int
    lines: int
    structure: Structure
    bounded: bool = False
    summed: bool = False
    motion: MotionShape | None = None
    charged: bool = False
    slacked: bool = True

    @property
    def bounds(self) -> int:
        """Return the number of rows that bound connectivity: of each stage, or of the sum."""
        return self.horizon if self.bounded else int(self.summed)

    @property
    def slacks(self) -> int:
        """Return the number of slacks, one of each such row if any."""
        return self.bounds if self.slacked else 0

    @property
    def driven(self) -> int:
        """Variables of the robot's dynamics."""
        return 0 if self.motion is None else self.motion.variables

    @property
    def variables(self) -> int:
        """Return all variables: places, slacks, those of the dynamics."""
        return 2 * self.horizon + self.slacks + self.driven

    @property
    def per_m(self) -> NDArray[np.float64]:
        """``(variables,)`` how far each may go for a metre of a place, in a trust region.

        Infinite for slacks and inputs, which follow from the rest.
        """
        places, slacks = np.ones(2 * self.horizon), np.full(self.slacks, np.inf)
        if self.motion is None:
            return np.concatenate([places, slacks])
        units = np.array(self.motion.dynamics.unit_m(self.motion.step_s)[2:])
        inputs = np.full(self.motion.per_step - len(units), np.inf)
        step = np.concatenate([1.0 / units, inputs])
        return np.concatenate([places, slacks, np.tile(step, self.horizon)])
