"""A term of one's own fits the problem that it is in."""

from __future__ import annotations

import numpy as np

from planopt.errors import InputError
from planopt.objectives.expression import START, WIDTHS, expression_values, names_in
from planopt.problems.objective import CasadiTerm
from planopt.problems.problem import Problem


def check_expression(problem: Problem, term: CasadiTerm, key: str) -> None:
    """The instructions are some of an expression of as many steps as are planned."""
    steps = problem.planner.horizon
    if term.steps != steps:
        raise InputError(
            f"is {term.steps}, and planner.horizon is {steps}",
            file=problem.file,
            key=f"{key}.steps",
            remedy="write the term by planopt.casadi_term for this horizon",
        )
    nothing = {name: np.zeros((1, steps, width)) for name, width in WIDTHS.items()}
    try:
        expression_values(term.program, steps, nothing | {START: np.zeros((1, 1, 2))})
    except InputError as error:
        raise InputError(
            error.message, file=problem.file, key=f"{key}.{error.key}", remedy=error.remedy
        ) from None
    if "target_m" in names_in(term.program) and not problem.targets:
        raise InputError(
            "reads target_m, and there is no target",
            file=problem.file,
            key=f"{key}.program",
            remedy="add an entry of targets and a term of kind tracking, of weight 0 if need be",
        )
