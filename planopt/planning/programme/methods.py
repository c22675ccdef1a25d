# pyright: basic
"""By which method a built programme is solved."""

from __future__ import annotations

from typing import Any, Literal

from planopt.planning.programme.ipopt import ipopt_solve
from planopt.planning.programme.nlp_functions import SolveNlp
from planopt.planning.programme.path_shape import PathShape

Method = Literal["ipopt", "scp"]
"""Interior points, or sequential convex programming."""

METHODS: dict[str, Method] = {"auto": "ipopt", "nlp": "ipopt", "scp": "scp"}
"""Of the planners that polish; the others do not."""


def solve_by(
    method: Method, solver: Any, shape: PathShape, budget_s: float | None = None
) -> SolveNlp:
    """Solve a programme over a path of a shape, built as a CasADi `solver`, by a method.

    A solve ends after `budget_s` seconds, if that is given; IPOPT has that among its options.
    """
    if method == "ipopt":
        return ipopt_solve(solver, shape.horizon)
    # Not needed by those who never ask for it.
    from planopt.planning.programme.cone_rows import motion_cones, step_cones
    from planopt.planning.programme.nlp_functions import nlp_functions
    from planopt.planning.programme.scp import scp_solve

    motion, n = shape.motion, shape.horizon
    cones = step_cones(n) if motion is None else motion_cones(shape)
    longest = None if motion is None else motion.dynamics.speed_max_m_s * motion.step_s
    return scp_solve(nlp_functions(solver), n, cones, shape.per_m, longest, budget_s)
