# pyright: basic
"""The reach problem over N steps as a parametric nonlinear programme: the CasADi boundary.

Nothing else in planopt touches a CasADi type; what goes in and comes out here is NumPy. CasADi
ships no usable type stubs, hence the looser checking of this one file.

Variables are the positions q_1..q_N and a slack s_k of each stage's connectivity bound. With h the
step duration, L the longest step, and (n, b) separating lines that are fixed from the start path
and applied to both ends of a segment (so that the whole segment is clear: design 4.3)::

    min   scale (w / h sum |q_k - q_{k-1}|^2 + rate |q_N - pivot|) + slack_weight sum s_k
    s.t.  |q_k - q_{k-1}|^2 <= L^2                   k = 1..N             "speed"
          n_kj . q_k     >= b_kj                     k = 1..N, all j      "line_end"
          n_kj . q_{k-1} >= b_kj                     k = 2..N, all j      "line_start"
          margin_k(q_k) + s_k >= bound_k             k = 1..N             "connectivity"

The margins come from :mod:`planopt.planning.stage_kernel` with exact derivatives, by callbacks
(five times faster than their symbolic form: fast.md); everything else is symbolic. The solver is
built once per structure and reused; a failed solve leaves nothing behind, because every call sets
start, bounds and parameters anew and passes no multipliers on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.planning.margin_source import MarginSource

PIVOT_ROUNDING_M = 1e-2
"""Rounding of the distance to the pivot, so that its gradient exists at the pivot."""

IPOPT_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "calc_lam_p": False,
    "no_nlp_grad": True,
    "show_eval_warnings": False,
    "error_on_fail": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.mu_init": 1e-2,
    "ipopt.tol": 1e-5,
    "ipopt.constr_viol_tol": 1e-6,
    "ipopt.acceptable_iter": 0,
    "ipopt.max_soc": 0,
    "ipopt.max_iter": 100,
}
"""Acceptable points are off: their constraint tolerance is 1e-2. So are second order corrections:
with them IPOPT cycled at the rounded kink of a pivot within reach in 14 of 180 straight tasks,
without in none, and elsewhere they gained nothing."""


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
    callbacks
        Kept so that they live as long as the solver.
    """

    horizon: int
    lines: int
    source: MarginSource
    solver: Any
    callbacks: tuple[Any, ...]


@dataclass(frozen=True)
class NlpPoint:
    """What the solver returned.

    Attributes
    ----------
    positions_m
        ``(N, 2)``.
    slack_db
        ``(N,)``.
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


class _StageCallback(ca.Callback):
    """One of the margin quantities as a CasADi function of the flattened positions."""

    def __init__(self, name: str, source: MarginSource, quantity: str, width: int) -> None:
        ca.Callback.__init__(self)
        self._source = source
        self._quantity = quantity
        self._width = width
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, _index: int) -> Any:
        return ca.Sparsity.dense(2 * self._source.stages, 1)

    def get_sparsity_out(self, _index: int) -> Any:
        return ca.Sparsity.dense(self._width * self._source.stages, 1)

    def eval(self, arguments: Any) -> list[Any]:
        flat = np.asarray(arguments[0].nonzeros())
        values = getattr(self._source.at(flat), self._quantity)
        return [ca.DM(values.ravel())]


def _rows(n: int, lines: int, q: Any, start: Any, line: Any) -> Any:
    """Stack the rows but the connectivity ones, in the order of the module's docstring."""
    speed, line_end, line_start = [], [], []
    for k in range(n):
        here = q[2 * k : 2 * k + 2]
        before = start if k == 0 else q[2 * k - 2 : 2 * k]
        speed.append(ca.sumsqr(here - before))
        for j in range(lines):
            at = 3 * (k * lines + j)
            line_end.append(line[at] * here[0] + line[at + 1] * here[1] - line[at + 2])
            if k > 0:
                line_start.append(line[at] * before[0] + line[at + 1] * before[1] - line[at + 2])
    return ca.vertcat(*speed, *line_end, *line_start)


def _objective(n: int, q: Any, s: Any, p: Any) -> Any:
    """Assemble the cost; `p` = start (2), pivot (2), effort / h, rate, scale, slack weight."""
    before = ca.vertcat(p[0:2], q[: 2 * n - 2])
    effort = p[4] * ca.sumsqr(q - before)
    to_pivot = ca.sqrt(ca.sumsqr(q[2 * n - 2 :] - p[2:4]) + PIVOT_ROUNDING_M**2)
    return p[6] * (effort + p[5] * to_pivot) + p[7] * ca.sum1(s)


def build_reach_nlp(horizon: int, lines: int) -> ReachNlp:
    """Build the programme for N = `horizon` steps and `lines` separating lines a segment."""
    n = horizon
    source = MarginSource(n)
    value = _StageCallback("margin", source, "value", 1)
    gradient = _StageCallback("margin_gradient", source, "gradient", 2)
    hessian = _StageCallback("margin_hessian", source, "hessian", 3)

    q, s = ca.SX.sym("q", 2 * n), ca.SX.sym("s", n)
    head, line = ca.SX.sym("head", 8), ca.SX.sym("line", 3 * n * lines)
    x_sx, p_sx = ca.vertcat(q, s), ca.vertcat(head, line)
    f_sx = _objective(n, q, s, head)
    g_sx = _rows(n, lines, q, head[0:2], line)
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
    options = dict(IPOPT_OPTIONS)
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
    return ReachNlp(n, lines, source, solver, (value, gradient, hessian))


def call_reach_nlp(
    nlp: ReachNlp,
    start: NDArray[np.float64],
    parameters: NDArray[np.float64],
    variable_bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
    row_bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> NlpPoint:
    """Solve once from `start` (3N: positions, slacks); arrays in the programme's order.

    What CasADi refuses to start with, such as a bound that is no number, comes back as a point of
    NaN with the status ``Invalid_Problem_Definition``.
    """
    try:
        result = nlp.solver(
            x0=start,
            p=parameters,
            lbx=variable_bounds[0],
            ubx=variable_bounds[1],
            lbg=row_bounds[0],
            ubg=row_bounds[1],
        )
    except RuntimeError:
        return _no_point(nlp, len(row_bounds[0]))
    stats = nlp.solver.stats()
    x = np.asarray(result["x"]).ravel()
    n = nlp.horizon
    return NlpPoint(
        positions_m=x[: 2 * n].reshape(n, 2),
        slack_db=x[2 * n :],
        row_multipliers=np.asarray(result["lam_g"]).ravel(),
        variable_multipliers=np.asarray(result["lam_x"]).ravel(),
        status=str(stats["return_status"]),
        iterations=int(stats.get("iter_count", 0)),
    )


def _no_point(nlp: ReachNlp, rows: int) -> NlpPoint:
    n = nlp.horizon
    return NlpPoint(
        positions_m=np.full((n, 2), np.nan),
        slack_db=np.full(n, np.nan),
        row_multipliers=np.full(rows, np.nan),
        variable_multipliers=np.full(3 * n, np.nan),
        status="Invalid_Problem_Definition",
        iterations=0,
    )
