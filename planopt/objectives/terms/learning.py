"""The term ``path_loss_learning``: information on the path loss from measurements on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from planopt.objectives.terms.term import Term

LearningCriterion = Literal["T", "D", "A", "V"]


@dataclass(frozen=True)
class LearningTerm(Term):
    """Information on the path loss that measurements along the path give.

    Attributes
    ----------
    weight
        Factor in the sum of terms.
    criterion
        ``T`` (trace), ``D``, ``A`` or ``V`` (prediction over the workspace).
    """

    criterion: Annotated[
        LearningCriterion,
        Field(
            description="T (trace of the information), D (volume), A (variances) or V (prediction "
            "over the workspace)."
        ),
    ] = "D"

    kind: ClassVar[str] = "path_loss_learning"
    summary: ClassVar[str] = "Learn the path loss."
    task: ClassVar[str | None] = "learn"

    @property
    def is_measured(self) -> bool:
        """The value is what measurements tell."""
        return True
