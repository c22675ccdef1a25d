# pyright: basic
"""The best path of N steps for any smooth value of it, as a parametric nonlinear programme.

What goes in and comes out here is NumPy. Variables are the positions q_1..q_N and a slack s_k of
each stage's connectivity bound::

    max   scale * value(q_1, ..., q_N) - slack_weight sum s_k
    s.t.  the rows of planopt.planning.programme.path_rows
          margin_k(q_k) + s_k >= bound_k             k = 1..N             "connectivity"

Value and margins come by callbacks with exact first and second derivatives. A *stagewise* value is
a sum over stages, whose Hessian has a 2 x 2 block for each; any other has a full one. A robot that
cannot turn or stop at will adds variables after these and rows before "connectivity", those of
:mod:`planopt.planning.programme.motion_rows`. The solver is built once per structure and reused; a
failed solve leaves nothing behind, because every call sets start, bounds and parameters anew and
passes no multipliers on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planopt.planning.programme.ipopt import OPTIONS
from planopt.planning.programme.motion_rows import MotionShape, motion_rows
from planopt.planning.programme.path_rows import PathCallback, path_rows
from planopt.planning.programme.path_value import ValueSource

NEAR_START: dict[str, Any] = {
    "ipopt.mu_init": 1e-3,
    "ipopt.bound_push": 1e-3,
    "ipopt.bound_frac": 1e-3,
    "ipopt.slack_bound_push": 1e-3,
    "ipopt.slack_bound_frac": 1e-3,
}
"""Starts are paths that keep all rows and lie near the best one: with IPOPT's own barrier, which
first drives the iterates to the middle, one long solve in ten does not return (40 steps)."""


@dataclass(frozen=True)
class PathNlp:
    """A built solver.

    Attributes
    ----------
    horizon, lines
        Its structure: N, and separating lines a segment.
    bounded
        Whether it has connectivity rows.
    source
        Where its value and margins come from.
    solver
        The CasADi solver.
    callbacks
        Kept so that they live as long as the solver.
    motion
        The rows of the robot's dynamics; None for the single integrator.
    """

    horizon: int
    lines: int
    bounded: bool
    source: ValueSource
    solver: Any
    callbacks: tuple[Any, ...]
    motion: MotionShape | None = None


def build_path_nlp(
    horizon: int, lines: int, stagewise: bool, bounded: bool, motion: MotionShape | None = None
) -> PathNlp:
    """Build the programme for N = `horizon` steps and `lines` separating lines a segment.

    Parameters
    ----------
    horizon, lines
        Its structure.
    stagewise
        Whether the value is a sum over stages.
    bounded
        Whether connectivity is bounded.
    motion
        The structure of the rows of the robot's dynamics; None for the single integrator.
    """
    n = horizon
    driven = 0 if motion is None else motion.variables
    source = ValueSource()
    stages = n if bounded else 0
    curved = 3 * n if stagewise else 4 * n * n
    callbacks = (
        PathCallback("value", n, 1, lambda at: np.array([source.at(at).value])),
        PathCallback("value_gradient", n, 2 * n, lambda at: source.at(at).gradient),
        PathCallback("value_hessian", n, curved, lambda at: source.at(at).hessian),
    )
    margins = (
        (
            PathCallback("margin", n, n, lambda at: source.margins_at(at).value),
            PathCallback("margin_gradient", n, 2 * n, lambda at: source.margins_at(at).gradient),
            PathCallback("margin_hessian", n, 3 * n, lambda at: source.margins_at(at).hessian),
        )
        if bounded
        else ()
    )

    q, s = ca.SX.sym("q", 2 * n), ca.SX.sym("s", stages)
    head, line = ca.SX.sym("head", 4), ca.SX.sym("line", 3 * n * lines)
    w, own = ca.SX.sym("w", driven), ca.SX.sym("own", 0 if motion is None else motion.parameters)
    x_sx, p_sx = ca.vertcat(q, s, w), ca.vertcat(head, line, own)
    g_sx = path_rows(n, lines, q, head[0:2], line)
    if motion is not None:
        start = (head[0], head[1], *(own[i] for i in range(motion.rest)))
        all_lines = ca.vertcat(line, own[motion.rest :])
        g_sx = ca.vertcat(g_sx, *motion_rows(motion, q, w, start, all_lines).stacked())
    plain = g_sx.numel()
    v, dv, hv = ca.SX.sym("v"), ca.SX.sym("dv", 2 * n), ca.SX.sym("hv", curved)
    m, dm, hm = (
        ca.SX.sym(name, width * stages) for name, width in (("m", 1), ("dm", 2), ("hm", 3))
    )
    lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", plain + stages)
    # The solver minimises.
    f_sx = -head[2] * v + head[3] * ca.sum1(s)
    df_sx = ca.vertcat(-head[2] * dv, head[3] * ca.SX.ones(stages), ca.SX.zeros(driven))
    value_curvature = _blocks(hv, n) if stagewise else ca.reshape(hv, 2 * n, 2 * n)
    curvature = (
        -lam_f * head[2] * ca.diagcat(value_curvature, ca.SX(stages + driven, stages + driven))
        + ca.hessian(ca.dot(lam[:plain], g_sx), x_sx)[0]
    )
    rows_sx, jacobian_sx = g_sx, ca.jacobian(g_sx, x_sx)
    if bounded:
        weighted = [lam[plain + k] * hm[3 * k + j] for k in range(n) for j in range(3)]
        curvature += ca.diagcat(_blocks(ca.vertcat(*weighted), n), ca.SX(n + driven, n + driven))
        rows_sx = ca.vertcat(g_sx, m + s)
        by_place = ca.diagcat(*[dm[2 * k : 2 * k + 2].T for k in range(n)])
        jacobian_sx = ca.vertcat(jacobian_sx, ca.horzcat(by_place, ca.SX.eye(n), ca.SX(n, driven)))
    objective = ca.Function("f", [x_sx, p_sx, v], [f_sx])
    gradient = ca.Function("df", [p_sx, dv], [df_sx])
    rows = ca.Function("g", [x_sx, p_sx, m], [rows_sx])
    jacobian = ca.Function("dg", [x_sx, p_sx, dm], [jacobian_sx])
    hessian = ca.Function("h", [x_sx, p_sx, lam_f, lam, hv, hm], [ca.triu(curvature)])

    x, p = ca.MX.sym("x", 2 * n + stages + driven), ca.MX.sym("p", p_sx.numel())
    lam_f_mx, lam_mx = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", plain + stages)
    at = x[: 2 * n]
    margin, margin_gradient, margin_hessian = (
        [callback(at) for callback in margins] if bounded else [ca.MX(0, 1)] * 3
    )
    f, g = objective(x, p, callbacks[0](at)), rows(x, p, margin)
    options = OPTIONS | NEAR_START
    # The solver asks these two for derivatives only; values here would be computed for nothing.
    no_f, no_g = ca.MX.nan(1), ca.MX.nan(plain + stages)
    options["grad_f"] = ca.Function(
        "nlp_grad_f", [x, p], [no_f, gradient(p, callbacks[1](at))], ["x", "p"], ["f", "grad_f_x"]
    )
    options["jac_g"] = ca.Function(
        "nlp_jac_g", [x, p], [no_g, jacobian(x, p, margin_gradient)], ["x", "p"], ["g", "jac_g_x"]
    )
    options["hess_lag"] = ca.Function(
        "nlp_hess_l",
        [x, p, lam_f_mx, lam_mx],
        [hessian(x, p, lam_f_mx, lam_mx, callbacks[2](at), margin_hessian)],
        ["x", "p", "lam_f", "lam_g"],
        ["triu_hess_gamma_x_x"],
    )
    solver = ca.nlpsol("path", "ipopt", {"x": x, "p": p, "f": f, "g": g}, options)
    return PathNlp(n, lines, bounded, source, solver, (*callbacks, *margins), motion)


def _blocks(entries: Any, n: int) -> Any:
    """Block diagonal of n symmetric 2 x 2 blocks given as xx, xy, yy."""
    return ca.diagcat(
        *[
            ca.vertcat(
                ca.horzcat(entries[3 * k], entries[3 * k + 1]),
                ca.horzcat(entries[3 * k + 1], entries[3 * k + 2]),
            )
            for k in range(n)
        ]
    )
