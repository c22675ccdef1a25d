"""A built IPOPT solver: its settings, and one call of it, arrays in and a point out.

Its raw return status is mapped to a `Termination`, totally: CasADi's `unified_return_status` hides
infeasible and NaN, and `success` includes acceptable points. An unknown string is a numerical
failure. A solver may be given exact derivatives instead of finding them itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Termination
from planopt.planning.programme.nlp_functions import (
    Bounds,
    NlpPoint,
    SolveNlp,
    lost_point,
    nlp_point,
)

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
"""Every status that IPOPT's interface defines."""


def termination_of(return_status: str) -> Termination:
    """Map a raw IPOPT status."""
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
    "ipopt.max_iter": 100,
}
"""Of every solver. Acceptable points are off: their constraint tolerance is 1e-2."""


def time_limit(budget_s: float | None) -> dict[str, Any]:
    """Options of a solver that ends after `budget_s` seconds; none without a limit."""
    return {} if budget_s is None else {"ipopt.max_wall_time": budget_s}


def ipopt_solve(solver: Any, horizon: int) -> SolveNlp:
    """Solve with a built CasADi solver over `horizon` stages."""

    def solve(
        start: NDArray[np.float64],
        parameters: NDArray[np.float64],
        variable_bounds: Bounds,
        row_bounds: Bounds,
    ) -> NlpPoint:
        return call_nlp(solver, horizon, start, parameters, variable_bounds, row_bounds)

    return solve


def call_nlp(
    solver: Any,
    horizon: int,
    start: NDArray[np.float64],
    parameters: NDArray[np.float64],
    variable_bounds: Bounds,
    row_bounds: Bounds,
) -> NlpPoint:
    """Solve once.

    What CasADi refuses to start with, such as a bound that is no number, comes back as a point of
    NaN.
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
    stats = solver.stats()
    return nlp_point(
        horizon,
        np.asarray(result["x"]).ravel(),
        np.asarray(result["lam_g"]).ravel(),
        np.asarray(result["lam_x"]).ravel(),
        termination_of(str(stats["return_status"])),
        int(stats.get("iter_count", 0)),
    )


@dataclass(frozen=True)
class ExactNlp:
    """Objective (minimised) and rows with their derivatives, CasADi expressions all."""

    x: Any  # Variables and parameters
    p: Any
    lam_f: Any  # Weight of the objective and multipliers of the rows
    lam_g: Any
    f: Any  # Objective and rows
    g: Any
    gradient: Any  # Of objective and rows
    jacobian: Any
    hessian: Any  # Upper triangle of that of lam_f f + lam_g . g.


def exact_solver(name: str, nlp: ExactNlp, options: dict[str, Any]) -> Any:
    """Build the solver, with IPOPT's `options`."""
    x, p = nlp.x, nlp.p
    # The solver asks these two for derivatives only; values here would be computed for nothing.
    no_f, no_g = ca.MX.nan(1), ca.MX.nan(nlp.g.numel())
    derivatives = {
        "grad_f": ca.Function(
            "nlp_grad_f", [x, p], [no_f, nlp.gradient], ["x", "p"], ["f", "grad_f_x"]
        ),
        "jac_g": ca.Function(
            "nlp_jac_g", [x, p], [no_g, nlp.jacobian], ["x", "p"], ["g", "jac_g_x"]
        ),
        "hess_lag": ca.Function(
            "nlp_hess_l",
            [x, p, nlp.lam_f, nlp.lam_g],
            [nlp.hessian],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        ),
    }
    return ca.nlpsol(name, "ipopt", {"x": x, "p": p, "f": nlp.f, "g": nlp.g}, options | derivatives)
