# pyright: basic
"""By which method a built programme is solved."""

from __future__ import annotations

from typing import Any, Literal

from planopt.planning.programme.ipopt import ipopt_solve
from planopt.planning.programme.nlp_point import SolveNlp
from planopt.problems.settings import PlannerName

Method = Literal["ipopt", "scp"]
"""Interior points, or sequential convex programming."""

METHODS: dict[PlannerName, Method] = {"auto": "ipopt", "nlp": "ipopt", "scp": "scp"}
"""Of the planners that polish; the others do not."""


def solve_by(
    method: Method, solver: Any, horizon: int, cones: int, budget_s: float | None = None
) -> SolveNlp:
    """Solve a programme over `horizon` stages, built as a CasADi `solver`, by a method.

    The first `cones` rows are the squared lengths of its path's steps. A solve ends after
    `budget_s` seconds, if that is given; IPOPT has that among its options.
    """
    if method == "ipopt":
        return ipopt_solve(solver, horizon)
    # Not needed by those who never ask for it.
    from planopt.planning.programme.nlp_functions import nlp_functions
    from planopt.planning.programme.scp import scp_solve

    return scp_solve(nlp_functions(solver), horizon, cones, budget_s)
