"""Values and derivatives of a built programme as NumPy has them, and its points.

A point is what any solver of a programme over a path is given, and what it gives back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Termination
from planopt.planning.programme.kkt import Bounds

Point = NDArray[np.float64]


@dataclass(frozen=True)
class NlpFunctions:
    """Functions of variables x, parameters p and rows' multipliers.

    Attributes
    ----------
    values
        ``(x, p)`` to the objective (minimised), and to all rows.
    derivatives
        ``(x, p, multipliers)`` to the gradient of the objective, the Jacobian of the rows, and the
        Hessian of objective + multipliers . rows.
    """

    values: Callable[[Point, Point], tuple[float, Point]]
    derivatives: Callable[[Point, Point, Point], tuple[Point, Point, Point]]


def nlp_functions(solver: Any) -> NlpFunctions:
    """The functions that a CasADi solver was built with."""
    f, g, df, dg, h = (
        solver.get_function(name)
        for name in ("nlp_f", "nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
    )
    x, p, multipliers = (
        ca.MX.sym(name, h.size1_in(at)) for at, name in ((0, "x"), (1, "p"), (3, "m"))
    )
    both = ca.Function("values", [x, p], [f(x, p), g(x, p)])
    outputs = [df(x, p)[1], dg(x, p)[1], h(x, p, 1.0, multipliers)]
    all_three = ca.Function("derivatives", [x, p, multipliers], outputs)

    def values(at: Point, parameters: Point) -> tuple[float, Point]:
        value, rows = both(at, parameters)
        return float(value), rows.full().ravel()

    def derivatives(at: Point, parameters: Point, by: Point) -> tuple[Point, Point, Point]:
        gradient, jacobian, upper = (part.full() for part in all_three(at, parameters, by))
        return gradient.ravel(), jacobian, upper + np.triu(upper, 1).T

    return NlpFunctions(values, derivatives)


@dataclass(frozen=True)
class NlpPoint:
    """What the solver returned.

    Attributes
    ----------
    positions_m
        ``(N, 2)``.
    slack_db
        ``(N,)``, or ``(0,)`` where no connectivity is bounded; variables that a programme has
        besides come after them.
    row_multipliers, variable_multipliers
        By row of the programme and by variable; positive at an upper bound, negative at a lower.
    termination
        Why it stopped.
    iterations
        Its count.
    """

    positions_m: NDArray[np.float64]
    slack_db: NDArray[np.float64]
    row_multipliers: NDArray[np.float64]
    variable_multipliers: NDArray[np.float64]
    termination: Termination
    iterations: int


def nlp_point(
    horizon: int,
    variables: NDArray[np.float64],
    row_multipliers: NDArray[np.float64],
    variable_multipliers: NDArray[np.float64],
    termination: Termination,
    iterations: int,
) -> NlpPoint:
    """A point from all variables in the programme's order: positions, two a stage, then slacks."""
    places = 2 * horizon
    return NlpPoint(
        variables[:places].reshape(horizon, 2),
        variables[places:],
        row_multipliers,
        variable_multipliers,
        termination,
        iterations,
    )


def lost_point(horizon: int, variables: int, rows: int) -> NlpPoint:
    """What stands for a solve that could not begin: no numbers at all."""
    nothing = np.full(variables, np.nan)
    failure = Termination.NUMERICAL_FAILURE
    return nlp_point(horizon, nothing, np.full(rows, np.nan), nothing, failure, 0)


SolveNlp = Callable[[NDArray[np.float64], NDArray[np.float64], Bounds, Bounds], NlpPoint]
"""From a start, parameters, and bounds of variables and of rows, in the programme's order."""
