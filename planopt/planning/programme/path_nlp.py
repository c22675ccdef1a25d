# pyright: basic
"""The best path of N steps for any smooth value of it, as a parametric nonlinear programme.

What goes in and comes out here is NumPy. Variables are the positions q_1..q_N and a slack s_k of
each stage's connectivity bound::

    max   scale * value(q_1, ..., q_N) - slack_weight sum s_k
    s.t.  the rows of planopt.planning.programme.path_rows
          margin_k(q_k) + s_k >= bound_k             k = 1..N             "connectivity"
          total(q_1, ..., q_N) + c t >= bound                             "connectivity"

There are rows of margins, one of a total (a sum over stages), or none. The total's slack t is in dB
like the others, c what a dB is worth.

Value and margins come by callbacks with exact first and second derivatives. What the value couples
(:data:`planopt.planning.programme.path_value.Structure`) is known to the solver. A robot that
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

from planopt.planning.programme.ipopt import OPTIONS, time_limit
from planopt.planning.programme.methods import Method, solve_by
from planopt.planning.programme.motion_rows import MotionShape, motion_rows
from planopt.planning.programme.nlp_point import SolveNlp
from planopt.planning.programme.path_rows import PathCallback, path_rows
from planopt.planning.programme.path_value import Structure, ValueSource

NEAR_START: dict[str, Any] = {
    "ipopt.mu_init": 1e-3,
    "ipopt.bound_push": 1e-3,
    "ipopt.bound_frac": 1e-3,
    "ipopt.slack_bound_push": 1e-3,
    "ipopt.slack_bound_frac": 1e-3,
    "ipopt.constr_mult_init_max": 0.0,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.min_refinement_steps": 0,
    "ipopt.max_iter": 30,
}
"""Starts are paths that keep all rows and lie near the best one: with IPOPT's own barrier, which
first drives the iterates to the middle, one long solve in ten does not return (40 steps). Least
squares for the first multipliers, scaling (the value comes scaled) and refinement of well
conditioned steps cost a sixth of the time and gain nothing. A solve of more than 30 iterations ends
nowhere useful."""

SETTLED: dict[str, Any] = {
    "ipopt.acceptable_iter": 2,
    "ipopt.acceptable_obj_change_tol": 3e-4,
    "ipopt.acceptable_constr_viol_tol": 1e-6,
    "ipopt.acceptable_tol": 1e6,
    "ipopt.acceptable_dual_inf_tol": 1e9,
    "ipopt.acceptable_compl_inf_tol": 1e9,
}
"""A path that keeps all rows and gained less than this share in two iterations is acceptable: what
is left is worth 0.05 % in the mean, and costs every third iteration."""


@dataclass(frozen=True)
class PathNlp:
    """A built solver.

    Attributes
    ----------
    horizon, lines
        Its structure: N, and separating lines a segment.
    bounded, summed
        Whether it has connectivity rows of margins, or that of a total.
    source
        Where its value and margins come from.
    solver
        The CasADi solver.
    solve
        One call of it, or of another method with its functions.
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
    solve: SolveNlp
    callbacks: tuple[Any, ...]
    summed: bool = False
    motion: MotionShape | None = None


def build_path_nlp(
    horizon: int,
    lines: int,
    structure: Structure,
    bounded: bool,
    summed: bool = False,
    method: Method = "ipopt",
    budget_s: float | None = None,
    until_settled: bool = False,
    motion: MotionShape | None = None,
) -> PathNlp:
    """Build the programme for N = `horizon` steps and `lines` separating lines a segment.

    Parameters
    ----------
    horizon, lines
        Its structure.
    structure
        Which stages the value couples.
    bounded
        Whether connectivity is bounded at stages.
    summed
        Whether a sum over stages is bounded.
    method
        Whose solver: IPOPT's, or sequential convex programming.
    budget_s
        Seconds after which a solve ends; None for no limit.
    until_settled
        Stop where the value has `SETTLED`, which need not be a point of KKT.
    motion
        The structure of the rows of the robot's dynamics; None for the single integrator.
    """
    n = horizon
    driven = 0 if motion is None else motion.variables
    source = ValueSource()
    stages, totals = n if bounded else 0, int(summed)
    slacks = stages + totals
    curved = {"stagewise": 3 * n, "chain": 7 * n - 4, "full": 4 * n * n}[structure]
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
    sums = (
        (
            PathCallback("total", n, 1, lambda at: np.array([source.total_at(at).value])),
            PathCallback("total_gradient", n, 2 * n, lambda at: source.total_at(at).gradient),
            PathCallback("total_hessian", n, 3 * n, lambda at: source.total_at(at).hessian),
        )
        if summed
        else ()
    )

    q, s = ca.SX.sym("q", 2 * n), ca.SX.sym("s", slacks)
    head, line = ca.SX.sym("head", 5), ca.SX.sym("line", 4 * n * lines)
    driving, own = (
        ca.SX.sym("driving", driven),
        ca.SX.sym("own", 0 if motion is None else motion.parameters),
    )
    x_sx, p_sx = ca.vertcat(q, s, driving), ca.vertcat(head, line, own)
    g_sx = path_rows(n, lines, q, head[0:2], line)
    if motion is not None:
        start = (head[0], head[1], *(own[i] for i in range(motion.rest)))
        all_lines = ca.vertcat(line, own[motion.rest :])
        g_sx = ca.vertcat(g_sx, *motion_rows(motion, q, driving, start, all_lines).stacked())
    plain = g_sx.numel()
    v, dv, hv = ca.SX.sym("v"), ca.SX.sym("dv", 2 * n), ca.SX.sym("hv", curved)
    m, dm, hm = (
        ca.SX.sym(name, width * stages) for name, width in (("m", 1), ("dm", 2), ("hm", 3))
    )
    w, dw, hw = (
        ca.SX.sym(name, width * totals) for name, width in (("w", 1), ("dw", 2 * n), ("hw", 3 * n))
    )
    lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", plain + slacks)
    # The solver minimises.
    f_sx = -head[2] * v + head[3] * ca.sum1(s)
    df_sx = ca.vertcat(-head[2] * dv, head[3] * ca.SX.ones(slacks), ca.SX.zeros(driven))
    value_curvature = _curvature(hv, n, structure)
    curvature = (
        -lam_f * head[2] * ca.diagcat(value_curvature, ca.SX(slacks + driven, slacks + driven))
        + ca.hessian(ca.dot(lam[:plain], g_sx), x_sx)[0]
    )
    rows_sx, jacobian_sx = g_sx, ca.jacobian(g_sx, x_sx)
    if bounded:
        weighted = [lam[plain + k] * hm[3 * k + j] for k in range(n) for j in range(3)]
        curvature += ca.diagcat(_blocks(ca.vertcat(*weighted), n), ca.SX(n + driven, n + driven))
        rows_sx = ca.vertcat(g_sx, m + s)
        by_place = ca.diagcat(*[dm[2 * k : 2 * k + 2].T for k in range(n)])
        jacobian_sx = ca.vertcat(jacobian_sx, ca.horzcat(by_place, ca.SX.eye(n), ca.SX(n, driven)))
    if summed:
        curvature += ca.diagcat(_blocks(lam[plain] * hw, n), ca.SX(1 + driven, 1 + driven))
        rows_sx = ca.vertcat(g_sx, w + head[4] * s)
        jacobian_sx = ca.vertcat(jacobian_sx, ca.horzcat(dw.T, head[4], ca.SX(1, driven)))
    objective = ca.Function("f", [x_sx, p_sx, v], [f_sx])
    gradient = ca.Function("df", [p_sx, dv], [df_sx])
    rows = ca.Function("g", [x_sx, p_sx, m, w], [rows_sx])
    jacobian = ca.Function("dg", [x_sx, p_sx, dm, dw], [jacobian_sx])
    hessian = ca.Function("h", [x_sx, p_sx, lam_f, lam, hv, hm, hw], [ca.triu(curvature)])

    x, p = ca.MX.sym("x", 2 * n + slacks + driven), ca.MX.sym("p", p_sx.numel())
    lam_f_mx, lam_mx = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", plain + slacks)
    at = x[: 2 * n]
    margin, margin_gradient, margin_hessian = (
        [callback(at) for callback in margins] if bounded else [ca.MX(0, 1)] * 3
    )
    total, total_gradient, total_hessian = (
        [callback(at) for callback in sums] if summed else [ca.MX(0, 1)] * 3
    )
    f, g = objective(x, p, callbacks[0](at)), rows(x, p, margin, total)
    options = OPTIONS | NEAR_START | time_limit(budget_s)
    if until_settled:
        options |= SETTLED
    # The solver asks these two for derivatives only; values here would be computed for nothing.
    no_f, no_g = ca.MX.nan(1), ca.MX.nan(plain + slacks)
    options["grad_f"] = ca.Function(
        "nlp_grad_f", [x, p], [no_f, gradient(p, callbacks[1](at))], ["x", "p"], ["f", "grad_f_x"]
    )
    options["jac_g"] = ca.Function(
        "nlp_jac_g",
        [x, p],
        [no_g, jacobian(x, p, margin_gradient, total_gradient)],
        ["x", "p"],
        ["g", "jac_g_x"],
    )
    options["hess_lag"] = ca.Function(
        "nlp_hess_l",
        [x, p, lam_f_mx, lam_mx],
        [hessian(x, p, lam_f_mx, lam_mx, callbacks[2](at), margin_hessian, total_hessian)],
        ["x", "p", "lam_f", "lam_g"],
        ["triu_hess_gamma_x_x"],
    )
    solver = ca.nlpsol("path", "ipopt", {"x": x, "p": p, "f": f, "g": g}, options)
    solve = solve_by(method, solver, n, n if motion is None else 0, budget_s)
    every = (*callbacks, *margins, *sums)
    return PathNlp(n, lines, bounded, source, solver, solve, every, summed, motion)


def _curvature(entries: Any, n: int, structure: Structure) -> Any:
    """Hessian of the value from the numbers of a `PathValue`."""
    if structure == "full":
        return ca.reshape(entries, 2 * n, 2 * n)
    found = _blocks(entries, n)
    if structure == "chain":
        for k in range(n - 1):
            at = 3 * n + 4 * k
            across = ca.vertcat(entries[at : at + 2].T, entries[at + 2 : at + 4].T)
            found[2 * k : 2 * k + 2, 2 * k + 2 : 2 * k + 4] = across
            found[2 * k + 2 : 2 * k + 4, 2 * k : 2 * k + 2] = across.T
    return found


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
