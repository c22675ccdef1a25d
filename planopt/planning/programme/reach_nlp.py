# pyright: basic
"""The reach problem over N steps as a parametric nonlinear programme: the CasADi boundary.

What goes in and comes out here is NumPy. CasADi ships no usable type stubs, hence the looser
checking of the files that touch its types.

Variables are the positions q_1..q_N and a slack s_k of each stage's connectivity bound. With h the
step duration::

    min   scale (w / h sum |q_k - q_{k-1}|^2 + rate |q_N - pivot|) + slack_weight sum s_k
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
from planopt.planning.programme.margin_source import MarginSource
from planopt.planning.programme.methods import Method, solve_by
from planopt.planning.programme.nlp_point import SolveNlp
from planopt.planning.programme.path_rows import PathCallback, path_rows

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
    callbacks: tuple[Any, ...]


def _objective(n: int, q: Any, s: Any, p: Any) -> Any:
    """Assemble the cost; `p` = start (2), pivot (2), effort / h, rate, scale, slack weight."""
    before = ca.vertcat(p[0:2], q[: 2 * n - 2])
    effort = p[4] * ca.sumsqr(q - before)
    to_pivot = ca.sqrt(ca.sumsqr(q[2 * n - 2 :] - p[2:4]) + PIVOT_ROUNDING_M**2)
    return p[6] * (effort + p[5] * to_pivot) + p[7] * ca.sum1(s)


def build_reach_nlp(
    horizon: int, lines: int, method: Method = "ipopt", budget_s: float | None = None
) -> ReachNlp:
    """Build the programme for N = `horizon` steps and `lines` separating lines a segment.

    A solve ends after `budget_s` seconds, if that is given.
    """
    n = horizon
    source = MarginSource(n)
    value = PathCallback("margin", n, n, lambda at: source.at(at).value)
    gradient = PathCallback("margin_gradient", n, 2 * n, lambda at: source.at(at).gradient)
    hessian = PathCallback("margin_hessian", n, 3 * n, lambda at: source.at(at).hessian)

    q, s = ca.SX.sym("q", 2 * n), ca.SX.sym("s", n)
    head, line = ca.SX.sym("head", 8), ca.SX.sym("line", 4 * n * lines)
    x_sx, p_sx = ca.vertcat(q, s), ca.vertcat(head, line)
    f_sx = _objective(n, q, s, head)
    g_sx = path_rows(n, lines, q, head[0:2], line)
    plain = g_sx.numel()
    m_sx, dm, hm = ca.SX.sym("m", n), ca.SX.sym("dm", 2 * n), ca.SX.sym("hm", 3 * n)
    lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", plain + n)
    margin_rows = ca.horzcat(ca.diagcat(*[dm[2 * k : 2 * k + 2].T for k in range(n)]), ca.SX.eye(n))
    blocks = [
        lam[plain + k]
        * ca.vertcat(ca.horzcat(hm[3 * k], hm[3 * k + 1]), ca.horzcat(hm[3 * k + 1], hm[3 * k + 2]))
        for k in range(n)
    ]
    lagrangian = lam_f * f_sx + ca.dot(lam[:plain], g_sx)
    curvature = ca.hessian(lagrangian, x_sx)[0] + ca.diagcat(*blocks, ca.SX(n, n))
    objective = ca.Function("f", [x_sx, p_sx], [f_sx])
    objective_gradient = ca.Function("df", [x_sx, p_sx], [ca.gradient(f_sx, x_sx)])
    rows = ca.Function("g", [x_sx, p_sx, m_sx], [ca.vertcat(g_sx, m_sx + s)])
    jacobian = ca.Function(
        "dg", [x_sx, p_sx, dm], [ca.vertcat(ca.jacobian(g_sx, x_sx), margin_rows)]
    )
    full_hessian = ca.Function("h", [x_sx, p_sx, lam_f, lam, hm], [ca.triu(curvature)])

    x, p = ca.MX.sym("x", 3 * n), ca.MX.sym("p", p_sx.numel())
    lam_f_mx, lam_mx = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", plain + n)
    at = x[: 2 * n]
    f, g = objective(x, p), rows(x, p, value(at))
    options = IPOPT_OPTIONS | ipopt.time_limit(budget_s)
    options["grad_f"] = ca.Function(
        "nlp_grad_f", [x, p], [f, objective_gradient(x, p)], ["x", "p"], ["f", "grad_f_x"]
    )
    options["jac_g"] = ca.Function(
        "nlp_jac_g", [x, p], [g, jacobian(x, p, gradient(at))], ["x", "p"], ["g", "jac_g_x"]
    )
    options["hess_lag"] = ca.Function(
        "nlp_hess_l",
        [x, p, lam_f_mx, lam_mx],
        [full_hessian(x, p, lam_f_mx, lam_mx, hessian(at))],
        ["x", "p", "lam_f", "lam_g"],
        ["triu_hess_gamma_x_x"],
    )
    solver = ca.nlpsol("reach", "ipopt", {"x": x, "p": p, "f": f, "g": g}, options)
    return ReachNlp(
        n,
        lines,
        source,
        solver,
        solve_by(method, solver, n, n, budget_s),
        (value, gradient, hessian),
    )
