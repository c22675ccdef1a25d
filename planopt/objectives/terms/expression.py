"""The term ``casadi``: a CasADi expression of the path, kept as plain instructions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from planopt.errors import InputError
from planopt.objectives.expression import START, WIDTHS, expression_values, names_in
from planopt.objectives.terms.term import Term, TermSetting


@dataclass(frozen=True)
class CasadiTerm(Term):
    """A user's own value of a path, written by :func:`planopt.objectives.casadi_term`.

    Attributes
    ----------
    weight
        Factor in the sum of terms.
    steps
        The horizon that it is for.
    program
        Its instructions (:mod:`planopt.objectives.expression`).
    """

    weight: Annotated[
        float,
        Field(
            default=1.0,
            ge=-1e9,
            le=1e9,
            description="In the sum of terms; negative for a cost.",
        ),
    ]
    steps: Annotated[int, Field(ge=1, description="The horizon that the expression is for.")]
    program: Annotated[str, Field(description="Its instructions, one a line.")]

    kind: ClassVar[str] = "casadi"
    summary: ClassVar[str] = "A value of one's own, made large."

    @property
    def needs_power(self) -> bool:
        """Expressions may read mean, standard deviation and connectivity."""
        return True

    @property
    def whole_horizon(self) -> bool:
        """The expression is for all steps."""
        return True

    @property
    def calibration_fault(self) -> str | None:
        """Mean and standard deviation say nothing of a calibrated law."""
        for name in ("mean_db", "deviation_db"):
            if name in names_in(self.program):
                return f"an expression reads {name}, which would stand for the calibrated law"
        return None

    def check(self, setting: TermSetting) -> None:
        """The instructions are some of an expression of as many steps as are planned."""
        if setting.stations > 1:
            self._check_stations(setting.stations)
        steps = setting.horizon
        if self.steps != steps:
            raise InputError(
                f"is {self.steps}, and planner.horizon is {steps}",
                key="steps",
                remedy="write the term by planopt.objectives.casadi_term for this horizon",
            )
        nothing = {name: np.zeros((1, steps, width)) for name, width in WIDTHS.items()}
        expression_values(self.program, steps, nothing | {START: np.zeros((1, 1, 2))})
        if "target_m" in names_in(self.program) and not setting.has_target:
            raise InputError(
                "reads target_m, and there is no target",
                key="program",
                remedy="add an entry of targets and a term of kind tracking, of weight 0 if need "
                "be",
            )

    def _check_stations(self, count: int) -> None:
        for name in ("mean_db", "deviation_db"):
            if name in names_in(self.program):
                raise InputError(
                    f"reads {name}, which is of one station's power, and there are {count} "
                    "stations",
                    key="program",
                    remedy="read connectivity, which is to any of them, or leave one entry of "
                    "stations",
                )
