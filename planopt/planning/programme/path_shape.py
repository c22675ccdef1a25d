"""Which structure a solver for any smooth value of a path is built for."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.planning.programme.motion_rows import MotionShape
from planopt.planning.programme.path_value import Structure


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

    @property
    def slacks(self) -> int:
        """Slacks: of each stage's bound, or of the sum's."""
        return self.horizon if self.bounded else int(self.summed)

    @property
    def driven(self) -> int:
        """Variables of the robot's dynamics."""
        return 0 if self.motion is None else self.motion.variables

    @property
    def variables(self) -> int:
        """All variables: places, slacks, those of the dynamics."""
        return 2 * self.horizon + self.slacks + self.driven
