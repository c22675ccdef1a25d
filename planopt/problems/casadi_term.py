"""A term from a CasADi expression of one's own."""

from __future__ import annotations

from typing import Any

from planopt.objectives.expression_casadi import program_of
from planopt.problems.objective import CasadiTerm


def casadi_term(expression: Any, horizon: int, weight: float = 1.0) -> CasadiTerm:
    """A term whose value, made large, is an expression of the path and the predicted channel.

    It is kept as plain instructions, so that problems, plans and runs with it are saved, judged
    again and sent to other processes like any other.

    Parameters
    ----------
    expression
        A function from :class:`planopt.objectives.expression_casadi.PathSymbols` (``positions_m``,
        ``mean_db``, ``deviation_db``, ``connectivity``, ``target_m``, ``start_m``) to a scalar
        CasADi expression, twice differentiable; or a `casadi.Function` of inputs of these names
        and shapes with one output.
    horizon
        N, the steps that it is for.
    weight
        In the sum of terms; negative for a cost.

    Raises
    ------
    InputError
        The expression is no scalar of these symbols.
    """
    return CasadiTerm(horizon, program_of(expression, horizon), weight=weight)
