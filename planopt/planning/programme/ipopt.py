# pyright: basic
"""One call of a built IPOPT solver over a path: settings, arrays in, a point out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
"""Of every solver (fast.md). Acceptable points are off: their constraint tolerance is 1e-2."""


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
    status
        IPOPT's raw return status.
    iterations
        Its count.
    """

    positions_m: NDArray[np.float64]
    slack_db: NDArray[np.float64]
    row_multipliers: NDArray[np.float64]
    variable_multipliers: NDArray[np.float64]
    status: str
    iterations: int


def call_nlp(
    solver: Any,
    horizon: int,
    start: NDArray[np.float64],
    parameters: NDArray[np.float64],
    variable_bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
    row_bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> NlpPoint:
    """Solve once from `start` (positions, then slacks); arrays in the programme's order.

    What CasADi refuses to start with, such as a bound that is no number, comes back as a point of
    NaN with the status ``Invalid_Problem_Definition``.
    """
    try:
        result = solver(
            x0=start,
            p=parameters,
            lbx=variable_bounds[0],
            ubx=variable_bounds[1],
            lbg=row_bounds[0],
            ubg=row_bounds[1],
        )
    except RuntimeError:
        lost = np.full(len(start), np.nan)
        rows = np.full(len(row_bounds[0]), np.nan)
        return _point(horizon, lost, rows, lost, "Invalid_Problem_Definition", 0)
    stats = solver.stats()
    return _point(
        horizon,
        np.asarray(result["x"]).ravel(),
        np.asarray(result["lam_g"]).ravel(),
        np.asarray(result["lam_x"]).ravel(),
        str(stats["return_status"]),
        int(stats.get("iter_count", 0)),
    )


def _point(
    horizon: int,
    x: NDArray[np.float64],
    rows: NDArray[np.float64],
    variables: NDArray[np.float64],
    status: str,
    iterations: int,
) -> NlpPoint:
    n = 2 * horizon
    return NlpPoint(x[:n].reshape(horizon, 2), x[n:], rows, variables, status, iterations)
