"""Interface to solvers of nonlinear programmes: functions, points, KKT residual, IPOPT call.

Sign convention: with rows g between bounds and variables x between bounds,
``grad f + J' lambda_g + lambda_x = 0``; multipliers are positive at an active upper bound and
negative at an active lower bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from planopt.arrays import Floats
from planopt.planning.plan import Termination

Point = Floats


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bounds of rows or variables."""

    lower: Floats
    upper: Floats


@dataclass(frozen=True)
class NlpPoint:
    """Point returned by a solver, with its multipliers and status."""

    positions_m: Floats  # (N, 2)
    others: Floats  # Slacks in dB, then variables of the dynamics
    row_multipliers: Floats
    variable_multipliers: Floats
    termination: Termination
    iterations: int


def nlp_point(
    horizon: int,
    variables: Floats,
    row_multipliers: Floats,
    variable_multipliers: Floats,
    termination: Termination,
    iterations: int,
) -> NlpPoint:
    """Return a solver's point from all variables, positions first."""
    places, others = np.split(variables, [2 * horizon])
    return NlpPoint(
        places.reshape(horizon, 2),
        others,
        row_multipliers,
        variable_multipliers,
        termination,
        iterations,
    )


def lost_point(horizon: int, variables: int, rows: int) -> NlpPoint:
    """Return a point of NaN, which stands for a failed solve."""
    nothing = np.full(variables, np.nan)
    failure = Termination.NUMERICAL_FAILURE
    return nlp_point(horizon, nothing, np.full(rows, np.nan), nothing, failure, 0)


SolveNlp = Callable[[Point, Point, Bounds, Bounds], NlpPoint]
"""Solve function with arguments guess, parameters, variable bounds and row bounds."""


@dataclass(frozen=True)
class NlpFunctions:
    """Functions of a nonlinear programme with variables x and parameters p, and derivatives."""

    # Maps (x, p) to the objective (minimised) and all rows
    values: Callable[[Point, Point], tuple[float, Point]]
    # Maps (x, p) to the objective's gradient and the rows' Jacobian
    slopes: Callable[[Point, Point], tuple[Point, Point]]
    # Maps (x, p, multipliers) to the Hessian of objective + multipliers . rows
    hessian: Callable[[Point, Point, Point], Point]


def nlp_functions(solver: Any) -> NlpFunctions:
    """Return the programme's functions from a built CasADi solver."""
    f, g, df, dg, h = (
        solver.get_function(name)
        for name in ("nlp_f", "nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
    )

    def values(at: Point, parameters: Point) -> tuple[float, Point]:
        return float(f(at, parameters)), _dense(g(at, parameters))[:, 0]

    def slopes(at: Point, parameters: Point) -> tuple[Point, Point]:
        return _dense(df(at, parameters)[1])[:, 0], _dense(dg(at, parameters)[1])

    def hessian(at: Point, parameters: Point, by: Point) -> Point:
        upper = _dense(h(at, parameters, 1.0, by))
        return upper + np.triu(upper, 1).T

    return NlpFunctions(values, slopes, hessian)


def _dense(matrix: Any) -> Floats:
    """Return a CasADi matrix as an array, faster than CasADi's own conversion."""
    found = np.zeros(matrix.shape)
    rows, columns = matrix.sparsity().get_triplet()
    found[rows, columns] = matrix.nonzeros()
    return found


def kkt_residual(
    gradient: Floats,
    jacobian: Floats,
    rows: Floats,
    row_bounds: Bounds,
    row_multipliers: Floats,
    variables: Floats,
    variable_bounds: Bounds,
    variable_multipliers: Floats,
) -> float:
    """Return the unscaled KKT residual at a point; infinite if any part is NaN.

    It is the maximum of stationarity, violation, wrong multiplier sign and complementarity.
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
        # A multiplier may only push away from its active bound.
        parts += [np.maximum(multiplier, 0.0) * _gap(above)]
        parts += [np.maximum(-multiplier, 0.0) * _gap(below)]
    # NumPy's maximum propagates NaN; Python's could lose it and report an exact point.
    worst = float(np.concatenate(parts).max(initial=0.0))
    return worst if np.isfinite(worst) else float("inf")


def _gap(distance: Floats) -> Floats:
    """Return finite distances to bounds: 1 for an infinite bound, because 0 * inf is NaN."""
    return np.where(np.isfinite(distance), np.abs(distance), 1.0)


TERMINATIONS: dict[str, Termination] = {
    "Solve_Succeeded": Termination.CONVERGED,
    "Solved_To_Acceptable_Level": Termination.ACCEPTABLE,
    "Infeasible_Problem_Detected": Termination.INFEASIBLE,
    "Search_Direction_Becomes_Too_Small": Termination.NUMERICAL_FAILURE,
    "Diverging_Iterates": Termination.NUMERICAL_FAILURE,
    "User_Requested_Stop": Termination.STOPPED,
    "Feasible_Point_Found": Termination.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": Termination.ITERATION_LIMIT,
    "Restoration_Failed": Termination.NUMERICAL_FAILURE,
    "Error_In_Step_Computation": Termination.NUMERICAL_FAILURE,
    "Maximum_CpuTime_Exceeded": Termination.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": Termination.TIME_LIMIT,
    "Not_Enough_Degrees_Of_Freedom": Termination.NUMERICAL_FAILURE,
    "Invalid_Problem_Definition": Termination.NUMERICAL_FAILURE,
    "Invalid_Option": Termination.NUMERICAL_FAILURE,
    "Invalid_Number_Detected": Termination.NUMERICAL_FAILURE,
    "Unrecoverable_Exception": Termination.NUMERICAL_FAILURE,
    "NonIpopt_Exception_Thrown": Termination.NUMERICAL_FAILURE,
    "Insufficient_Memory": Termination.NUMERICAL_FAILURE,
    "Internal_Error": Termination.NUMERICAL_FAILURE,
}
"""Termination for every status of IPOPT's interface."""


def termination_of(return_status: str) -> Termination:
    """Return the termination for a raw IPOPT status; unknown ones are numerical failures."""
    return TERMINATIONS.get(return_status, Termination.NUMERICAL_FAILURE)


OPTIONS: dict[str, Any] = {
    "print_time": False,
    "calc_lam_p": False,
    "no_nlp_grad": True,
    "show_eval_warnings": False,
    "error_on_fail": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.mu_init": 1e-2,
    "ipopt.tol": 1e-4,
    "ipopt.constr_viol_tol": 1e-6,
    "ipopt.acceptable_iter": 0,
    "ipopt.max_iter": 200,
}
"""Options of every solver. IPOPT's acceptable points are off, as they may violate rows by 1e-2."""


def call_nlp(
    solver: Any,
    horizon: int,
    start: Point,
    parameters: Point,
    variable_bounds: Bounds,
    row_bounds: Bounds,
) -> NlpPoint:
    """Return the point found by a CasADi solver; a point of NaN if CasADi rejects the input.

    The raw status is mapped because `unified_return_status` hides infeasible and NaN, and `success`
    includes acceptable points.
    """
    try:
        result = solver(
            x0=start,
            p=parameters,
            lbx=variable_bounds.lower,
            ubx=variable_bounds.upper,
            lbg=row_bounds.lower,
            ubg=row_bounds.upper,
        )
    except RuntimeError:
        return lost_point(horizon, len(start), len(row_bounds.lower))
    x, lam_g, lam_x = (np.asarray(result[name]).ravel() for name in ("x", "lam_g", "lam_x"))
    stats = solver.stats()
    termination = termination_of(str(stats["return_status"]))
    return nlp_point(horizon, x, lam_g, lam_x, termination, int(stats.get("iter_count", 0)))
