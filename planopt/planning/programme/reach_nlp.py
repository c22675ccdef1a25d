# pyright: basic
"""The reach problem over N steps as a parametric nonlinear programme: the CasADi boundary.

What goes in and comes out here is NumPy. CasADi ships no usable type stubs, hence the looser
checking of the files that touch its types.

Variables are the positions q_1..q_N. With h the step duration and Phi the normal distribution::

    min   w / h sum l_k^2 + rate |q_N - pivot| + price sum l_k (c_{k-1} + c_k) / 2
    s.t.  the rows of planopt.planning.programme.path_rows
          margin_k(q_k) >= bound_k                   k = 1..N             "connectivity"

with step lengths ``l_k = |q_k - q_{k-1}|``, rounded at zero, and the share of a metre that the
outage price is charged on, ``c_k = charged_k (1 - Phi(score_k(q_k)))``.

Margins and scores come from :mod:`planopt.planning.programme.stage_kernel` with exact derivatives,
by callbacks (five times faster than their symbolic form); everything else is symbolic. The solver
is built once per structure and reused; a failed solve leaves nothing behind, because every call
sets start, bounds and parameters anew and passes no multipliers on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from planopt.planning.programme import ipopt
from planopt.planning.programme.curvature import stage_rows, weighted_blocks
from planopt.planning.programme.ipopt import ExactNlp, exact_solver
from planopt.planning.programme.margin_source import MarginSource
from planopt.planning.programme.methods import Method, solve_by
from planopt.planning.programme.nlp_functions import SolveNlp
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


STEP_ROUNDING_M = 1e-2
"""The same of a step's length, at a standstill."""

HEAD = 8
"""Parameters before those of each step: start (2), pivot (2), effort / h, rate, price, c_0."""


def _objective(n: int, q: Any, score: Any, p: Any, charged: Any) -> Any:
    """Assemble the cost of positions and scores."""
    moved = ca.reshape(q - ca.vertcat(p[0:2], q[: 2 * n - 2]), 2, n)
    squares = ca.sum1(moved**2).T
    to_pivot = ca.sqrt(ca.sumsqr(q[2 * n - 2 :] - p[2:4]) + PIVOT_ROUNDING_M**2)
    share = charged * (0.5 - 0.5 * ca.erf(score / 2.0**0.5))
    lengths = ca.sqrt(squares + STEP_ROUNDING_M**2)
    outage = 0.5 * ca.dot(lengths, ca.vertcat(p[7], share)[:n] + share)
    return p[4] * ca.sum1(squares) + p[5] * to_pivot + p[6] * outage


def build_reach_nlp(
    horizon: int, lines: int, method: Method = "ipopt", budget_s: float | None = None
) -> ReachNlp:
    """Build the programme for N = `horizon` steps and `lines` separating lines a segment.

    A solve ends after `budget_s` seconds, if that is given.
    """
    n = horizon
    source = MarginSource(n)
    margins = path_callbacks("margin", n, 2 * n, 6 * n, source.at)
    q, head, charged = ca.SX.sym("q", 2 * n), ca.SX.sym("head", HEAD), ca.SX.sym("charged", n)
    line = ca.SX.sym("line", 4 * n * lines)
    p_sx = ca.vertcat(head, charged, line)
    m_sx, dm_sx, hm_sx = (ca.SX.sym(f"m{width}", 2 * width * n) for width in (1, 2, 3))
    f_sx = _objective(n, q, m_sx[n:], head, charged)
    f_q, f_m = ca.gradient(f_sx, q), ca.gradient(f_sx, m_sx)
    f_qm, f_mm = ca.jacobian(f_q, m_sx), ca.jacobian(f_m, m_sx)
    g_sx = path_rows(n, lines, q, head[0:2], line)
    plain = g_sx.numel()
    lam_f_sx, lam_sx = ca.SX.sym("lam_f"), ca.SX.sym("lam", plain + n)
    margin_rows = stage_rows(dm_sx[: 2 * n], n)
    stages = ca.vertcat(margin_rows, stage_rows(dm_sx[2 * n :], n))
    lagrangian = lam_f_sx * f_sx + ca.dot(lam_sx[:plain], g_sx)
    curved = weighted_blocks(lam_sx[plain:], hm_sx[: 3 * n], n)
    curved += weighted_blocks(lam_f_sx * f_m[n:], hm_sx[3 * n :], n)
    mixed = f_qm @ stages
    across = lam_f_sx * (mixed + mixed.T + stages.T @ f_mm @ stages)
    hessian_sx = ca.triu(ca.hessian(lagrangian, q)[0] + curved + across)
    objective = ca.Function("f", [q, p_sx, m_sx], [f_sx])
    gradient = ca.Function("df", [q, p_sx, m_sx, dm_sx], [f_q + stages.T @ f_m])
    rows = ca.Function("g", [q, p_sx, m_sx], [ca.vertcat(g_sx, m_sx[:n])])
    jacobian = ca.Function("dg", [q, p_sx, dm_sx], [ca.vertcat(ca.jacobian(g_sx, q), margin_rows)])
    hessian = ca.Function("h", [q, p_sx, lam_f_sx, lam_sx, m_sx, dm_sx, hm_sx], [hessian_sx])

    x, p = ca.MX.sym("x", 2 * n), ca.MX.sym("p", p_sx.numel())
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", plain + n)
    m, dm, hm = margins(x)
    nlp = ExactNlp(
        x,
        p,
        lam_f,
        lam_g,
        f=objective(x, p, m),
        g=rows(x, p, m),
        gradient=gradient(x, p, m, dm),
        jacobian=jacobian(x, p, dm),
        hessian=hessian(x, p, lam_f, lam_g, m, dm, hm),
    )
    solver = exact_solver("reach", nlp, IPOPT_OPTIONS | ipopt.time_limit(budget_s))
    shape = PathShape(n, lines, "stagewise", bounded=True, slacked=False)
    return ReachNlp(n, lines, source, solver, solve_by(method, solver, shape, budget_s), margins)
