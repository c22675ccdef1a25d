"""The term ``motion_energy``: energy of motion, subtracted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from planopt.objectives.terms.term import Structure, Term


@dataclass(frozen=True)
class MotionEnergyTerm(Term):
    """Energy of motion, a cost: k1 a metre and k2 a second while moving, in joules.

    Attributes
    ----------
    weight
        Factor in the sum of terms, per joule; the energy is subtracted.
    per_metre_j_m, power_w
        k1 and k2.
    """

    per_metre_j_m: Annotated[float, Field(ge=0, le=1e9, description="k1 in J/m.")]
    power_w: Annotated[float, Field(ge=0, le=1e9, description="k2 in W while moving.")] = 0.0

    kind: ClassVar[str] = "motion_energy"
    summary: ClassVar[str] = "Spare energy."
    task: ClassVar[str | None] = None

    @property
    def is_motion_cost(self) -> bool:
        """Energy is spent by moving alone."""
        return True

    @property
    def structure(self) -> Structure:
        """A step couples its two ends."""
        return "chain"
