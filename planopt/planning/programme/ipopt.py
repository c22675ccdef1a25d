# pyright: basic
"""A built IPOPT solver: its settings, and one call of it, arrays in and a point out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.planning.programme.ipopt_status import termination_of
from planopt.planning.programme.kkt import Bounds
from planopt.planning.programme.nlp_point import NlpPoint, SolveNlp, lost_point, nlp_point

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
