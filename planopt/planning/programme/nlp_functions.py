"""A built programme in NumPy: its functions, its points, and the residuals of a point.

A point is what a solver of a programme over a path is given, and what it gives back. Residuals are
those of the Karush-Kuhn-Tucker conditions. Nothing in them comes from CasADi: gradients are written
out again, so that a wrong derivative in the programme shows as a residual. Sign convention: with
rows g between bounds and variables x between bounds, ``grad f + J' lambda_g + lambda_x = 0``,
multipliers positive at an active upper bound and negative at an active lower bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Termination


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bounds of rows or variables."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


def kkt_residual(
    gradient: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    rows: NDArray[np.float64],
    row_bounds: Bounds,
    row_multipliers: NDArray[np.float64],
    variables: NDArray[np.float64],
    variable_bounds: Bounds,
    variable_multipliers: NDArray[np.float64],
) -> float:
    """Largest of stationarity, primal violation, wrong sign and complementarity, unscaled.

    Infinite where any of them is not a number.
    """
    free = variable_bounds.lower < variable_bounds.upper
    stationarity = gradient + jacobian.T @ row_multipliers + variable_multipliers
    parts = [np.abs(stationarity[free])]
    for value, bounds, multiplier in (
        (rows, row_bounds, row_multipliers),
        (variables, variable_bounds, variable_multipliers),
    ):
        below, above = value - bounds.lower, bounds.upper - value
        parts += [np.maximum(-below, 0.0), np.maximum(-above, 0.0)]
        # A multiplier may only push against the bound that it touches.
        parts += [np.maximum(multiplier, 0.0) * _gap(above)]
        parts += [np.maximum(-multiplier, 0.0) * _gap(below)]
    # NumPy's maximum: Python's would lose a NaN, and a point without a residual would look exact.
    worst = float(np.concatenate(parts).max(initial=0.0))
    return worst if np.isfinite(worst) else float("inf")


def _gap(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance to a bound; a missing bound counts as one unit away, so that 0 * inf is no NaN."""
    return np.where(np.isfinite(distance), np.abs(distance), 1.0)


def named_multipliers(
    rows: NDArray[np.float64], horizon: int, lines: int, bounds: int
) -> dict[str, NDArray[np.float64]]:
    """Return multipliers of :mod:`~planopt.planning.programme.path_nlp` and connectivity."""
    speed, line_end, line_start = np.split(
        rows[: horizon * (1 + 2 * lines) - lines], [horizon, horizon * (1 + lines)]
    )
    found = {
        "speed": speed,
        "line_end": line_end.reshape(horizon, lines),
        "line_start": line_start.reshape(horizon - 1, lines),
    }
    return found | ({"connectivity": rows[len(rows) - bounds :]} if bounds else {})


Point = NDArray[np.float64]


@dataclass(frozen=True)
class NlpFunctions:
    """Functions of variables x, parameters p and rows' multipliers."""

    # (x, p) to the objective (minimised), and to all rows
    values: Callable[[Point, Point], tuple[float, Point]]
    # (x, p, multipliers) to the gradient of the objective, the Jacobian of the rows, and the
    # Hessian of objective + multipliers . rows.
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
    """The point that the solver returned."""

    positions_m: NDArray[np.float64]  # (N, 2)
    # (N,), or (0,) where no connectivity is bounded; variables that a programme has besides come
    # after them
    slack_db: NDArray[np.float64]
    # By row of the programme and by variable; positive at an upper bound, negative at a lower
    row_multipliers: NDArray[np.float64]
    variable_multipliers: NDArray[np.float64]
    termination: Termination  # Why it stopped
    iterations: int  # Its count


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
    """Return the point of a solve that could not begin: no numbers at all."""
    nothing = np.full(variables, np.nan)
    failure = Termination.NUMERICAL_FAILURE
    return nlp_point(horizon, nothing, np.full(rows, np.nan), nothing, failure, 0)


SolveNlp = Callable[[NDArray[np.float64], NDArray[np.float64], Bounds, Bounds], NlpPoint]
"""From a start, parameters, and bounds of variables and of rows, in the programme's order."""
