"""What a user's expression reads, in one situation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.objectives.expression import START, names_in
from planopt.planning.worth.situation import Situation
from planopt.problems.objective import CasadiTerm


def known_inputs(term: CasadiTerm, at: Situation, steps: int) -> dict[str, NDArray[np.float64]]:
    """What does not depend on the path: the start (1, 2), and the target (N, 2) where there is one.

    Raises
    ------
    InputError
        The expression is for another number of steps, or reads a target that there is not.
    """
    if term.steps != steps:
        raise InputError(
            f"an expression is for {term.steps} steps, the plan has {steps}",
            key="objective.terms",
            remedy=f"build it again by planopt.objectives.casadi_term, with the horizon {steps}",
        )
    known = {START: at.position_m[None]}
    if at.target_m is not None:
        known["target_m"] = at.target_m
    elif "target_m" in names_in(term.program):
        raise InputError(
            "an expression reads target_m, and there is no target",
            key="objective.terms",
            remedy="add an entry of targets and a term of kind tracking, of weight 0 if need be",
        )
    return known
