# pyright: basic
"""The reach problem over N steps as a parametric nonlinear programme: the CasADi boundary.

What goes in and comes out here is NumPy. CasADi ships no usable type stubs, hence the looser
checking of the files that touch its types.

Variables are the positions q_1..q_N and a slack s_k of each stage's connectivity bound. With h the
step duration::

    min   w / h sum |q_k - q_{k-1}|^2 + rate |q_N - pivot| + slack_price sum s_k
    s.t.  the rows of planopt.planning.programme.path_rows
          margin_k(q_k) + s_k >= bound_k             k = 1..N             "connectivity"

The margins come from :mod:`planopt.planning.programme.stage_kernel` with exact derivatives, by
callbacks (five times faster than their symbolic form: fast.md); everything else is symbolic. The
solver is built once per structure and reused; a failed solve leaves nothing behind, because every
call sets start, bounds and parameters anew and passes no multipliers on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from planopt.planning.programme import ipopt
from planopt.planning.programme.curvature import stage_rows, weighted_blocks
from planopt.planning.programme.exact_solver import ExactNlp, exact_solver
from planopt.planning.programme.margin_source import MarginSource
from planopt.planning.programme.methods import Method, solve_by
from planopt.planning.programme.nlp_point import SolveNlp
from planopt.planning.programme.path_callback import PathCallbacks, path_callbacks
from planopt.planning.programme.path_rows import path_rows
from planopt.planning.programme.path_shape import PathShape

PIVOT_ROUNDING_M = 1e-2
"""Rounding of the distance to the pivot, so that its gradient exists at the pivot."""

IPOPT_OPTIONS: dict[str, Any] = {**ipopt.OPTIONS, "ipopt.tol": 1e-5, "ipopt.max_soc": 0}
"""No second order corrections: with them IPOPT cycled at the rounded kink of a pivot within reach
in 14 of 180 straight tasks, without in none, and elsewhere they gained nothing."""


@dataclass(frozen=True)
class ReachNlp:
    """A built solver.

    Attributes
    ----------
    horizon, lines
        Its structure: N, and separating lines a segment.
    source
        Where its margins come from.
    solver
        The CasADi solver.
    solve
        One call of it, or of another method with its functions.
    callbacks
        Kept so that they live as long as the solver.
    """

    horizon: int
    lines: int
    source: MarginSource
    solver: Any
    solve: SolveNlp
    callbacks: PathCallbacks


def _objective(n: int, q: Any, s: Any, p: Any) -> Any:
    """Assemble the cost; `p` = start (2), pivot (2), effort / h, rate, slack price."""
    before = ca.vertcat(p[0:2], q[: 2 * n - 2])
    effort = p[4] * ca.sumsqr(q - before)
    to_pivot = ca.sqrt(ca.sumsqr(q[2 * n - 2 :] - p[2:4]) + PIVOT_ROUNDING_M**2)
    return effort + p[5] * to_pivot + p[6] * ca.sum1(s)


def build_reach_nlp(
    horizon: int, lines: int, method: Method = "ipopt", budget_s: float | None = None
) -> ReachNlp:
    """Build the programme for N = `horizon` steps and `lines` separating lines a segment.

    A solve ends after `budget_s` seconds, if that is given.
    """
    n = horizon
    source = MarginSource(n)
    margins = path_callbacks("margin", n, n, 3 * n, source.at)
    q, s = ca.SX.sym("q", 2 * n), ca.SX.sym("s", n)
    head, line = ca.SX.sym("head", 7), ca.SX.sym("line", 4 * n * lines)
    x_sx, p_sx = ca.vertcat(q, s), ca.vertcat(head, line)
    f_sx = _objective(n, q, s, head)
    g_sx = path_rows(n, lines, q, head[0:2], line)
    plain = g_sx.numel()
    m_sx, dm_sx, hm_sx = (ca.SX.sym(f"m{width}", width * n) for width in (1, 2, 3))
    lam_f_sx, lam_sx = ca.SX.sym("lam_f"), ca.SX.sym("lam", plain + n)
    lagrangian = lam_f_sx * f_sx + ca.dot(lam_sx[:plain], g_sx)
    curved = ca.diagcat(weighted_blocks(lam_sx[plain:], hm_sx, n), ca.SX(n, n))
    hessian_sx = ca.triu(ca.hessian(lagrangian, x_sx)[0] + curved)
    margin_rows = ca.horzcat(stage_rows(dm_sx, n), ca.SX.eye(n))
    objective = ca.Function("f", [x_sx, p_sx], [f_sx])
    gradient = ca.Function("df", [x_sx, p_sx], [ca.gradient(f_sx, x_sx)])
    rows = ca.Function("g", [x_sx, p_sx, m_sx], [ca.vertcat(g_sx, m_sx + s)])
    jacobian = ca.Function(
        "dg", [x_sx, p_sx, dm_sx], [ca.vertcat(ca.jacobian(g_sx, x_sx), margin_rows)]
    )
    hessian = ca.Function("h", [x_sx, p_sx, lam_f_sx, lam_sx, hm_sx], [hessian_sx])

    x, p = ca.MX.sym("x", 3 * n), ca.MX.sym("p", p_sx.numel())
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", plain + n)
    m, dm, hm = margins(x[: 2 * n])
    nlp = ExactNlp(
        x,
        p,
        lam_f,
        lam_g,
        f=objective(x, p),
        g=rows(x, p, m),
        gradient=gradient(x, p),
        jacobian=jacobian(x, p, dm),
        hessian=hessian(x, p, lam_f, lam_g, hm),
    )
    solver = exact_solver("reach", nlp, IPOPT_OPTIONS | ipopt.time_limit(budget_s))
    shape = PathShape(n, lines, "stagewise", bounded=True)
    return ReachNlp(n, lines, source, solver, solve_by(method, solver, shape, budget_s), margins)
