# pyright: basic
"""The two parametric programmes over N steps: for any smooth value, and to reach a goal.

Variables are the positions q_1..q_N. For any smooth value, with a slack s_k of each stage's
connectivity bound::

    max   scale * value(q_1, ..., q_N) - slack_weight sum s_k
    s.t.  the rows of planopt.planning.programme.path_rows
          margin_k(q_k) + s_k >= bound_k             k = 1..N             "connectivity"
          total(q_1, ..., q_N) + c t >= bound                             "connectivity"

There are rows of margins, one of a total (a sum over stages), or none. The total's slack t is in dB
like the others, c what a dB is worth. The cost of the way to a goal
(:mod:`planopt.planning.programme.pivot`) is subtracted from the value, where it is charged.

To reach a goal, with h the step duration and Phi the normal distribution::

    min   w / h sum l_k^2 + rate |q_N - pivot| + price sum l_k (c_{k-1} + c_k) / 2
    s.t.  the rows of planopt.planning.programme.path_rows
          margin_k(q_k) >= bound_k                   k = 1..N             "connectivity"

with step lengths ``l_k = |q_k - q_{k-1}|``, rounded at zero, and the share of a metre that the
outage price is charged on, ``c_k = charged_k (1 - Phi(score_k(q_k)))``.

Value v, margins m and total w, or margins and scores, come by callbacks
(:mod:`planopt.planning.programme.margin_source`) with exact gradients (dv, dm, dw) and what is not
zero of their Hessians (hv, hm, hw): margins by callbacks take a fifth of the time of their symbolic
form. All else is symbolic.
What the value couples (:data:`planopt.planning.programme.margin_source.Structure`) is known to the
solver. The parameters of the first programme are ``head`` (start, scale, slack weight, what a dB is
worth in the total), the lines, and those of the robot's dynamics and its goal. A robot with
dynamics adds variables after the positions and rows before "connectivity", those of
:mod:`planopt.planning.programme.motion_rows`.

Inputs and outputs are NumPy. A solver is built once per structure and reused; a failed solve leaves
nothing behind, because every call sets start, bounds and parameters anew and passes no multipliers
on. CasADi ships no usable type stubs, hence the looser checking of the files that touch its types.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from planopt.planning.programme import ipopt
from planopt.planning.programme.ipopt import OPTIONS, ExactNlp, exact_solver, time_limit
from planopt.planning.programme.margin_source import MarginSource, ValueSource
from planopt.planning.programme.methods import Method, solve_by
from planopt.planning.programme.motion_rows import motion_rows
from planopt.planning.programme.nlp_functions import SolveNlp
from planopt.planning.programme.path_callback import PathCallbacks, path_callbacks
from planopt.planning.programme.path_rows import (
    curvature,
    curvature_size,
    path_rows,
    stage_blocks,
    stage_rows,
    weighted_blocks,
)
from planopt.planning.programme.path_shape import PathShape
from planopt.planning.programme.pivot import PARAMETERS, goal_cost_s


@dataclass(frozen=True)
class PathFunctions:
    """Functions of variables x, parameters p and what the callbacks give."""

    objective: Any  # (x, p, v) to the objective (minimised), (x, p, dv) to its gradient
    gradient: Any
    rows: Any  # (x, p, m, w) to all rows, (x, p, dm, dw) to their Jacobian
    jacobian: Any
    # (x, p, lam_f, lam_g, hv, hm, hw) to the upper triangle of the Lagrangian's Hessian
    hessian: Any
    parameters: int  # How many there are
    row_count: int


@dataclass(frozen=True)
class _Symbols:
    """Variables, parameters, the rows of the geometry and the dynamics, the cost of a goal."""

    s: Any
    head: Any
    x: Any
    p: Any
    plain: Any
    cost: Any


def path_functions(shape: PathShape) -> PathFunctions:
    """Write the programme of one structure."""
    at = _symbols(shape)
    n, slacks, driven, plain = shape.horizon, shape.slacks, shape.driven, at.plain.numel()
    x, p, head = at.x, at.p, at.head
    curved = curvature_size(n, shape.structure)
    v, dv, hv = ca.SX.sym("v"), ca.SX.sym("dv", 2 * n), ca.SX.sym("hv", curved)
    m, dm, hm = (ca.SX.sym(f"m{width}", width * n * int(shape.bounded)) for width in (1, 2, 3))
    w, dw, hw = (ca.SX.sym(f"w{size}", size * int(shape.summed)) for size in (1, 2 * n, 3 * n))
    lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", plain + slacks)
    # The solver minimises.
    objective = head[2] * (at.cost - v) + head[3] * ca.sum1(at.s)
    gradient = ca.vertcat(-head[2] * dv, head[3] * ca.SX.ones(slacks), ca.SX.zeros(driven))
    gradient += head[2] * ca.gradient(at.cost, x)
    beside = slacks + driven
    hessian = (
        -lam_f * head[2] * ca.diagcat(curvature(hv, n, shape.structure), ca.SX(beside, beside))
        + ca.hessian(lam_f * head[2] * at.cost + ca.dot(lam[:plain], at.plain), x)[0]
    )
    rows, jacobian = at.plain, ca.jacobian(at.plain, x)
    if shape.bounded:
        blocks = weighted_blocks(lam[plain:], hm, n)
        hessian += ca.diagcat(blocks, ca.SX(beside, beside))
        rows = ca.vertcat(rows, m + at.s)
        slopes = ca.horzcat(stage_rows(dm, n), ca.SX.eye(n), ca.SX(n, driven))
        jacobian = ca.vertcat(jacobian, slopes)
    if shape.summed:
        hessian += ca.diagcat(stage_blocks(lam[plain] * hw, n), ca.SX(beside, beside))
        rows = ca.vertcat(rows, w + head[4] * at.s)
        jacobian = ca.vertcat(jacobian, ca.horzcat(dw.T, head[4], ca.SX(1, driven)))
    return PathFunctions(
        objective=ca.Function("f", [x, p, v], [objective]),
        gradient=ca.Function("df", [x, p, dv], [gradient]),
        rows=ca.Function("g", [x, p, m, w], [rows]),
        jacobian=ca.Function("dg", [x, p, dm, dw], [jacobian]),
        hessian=ca.Function("h", [x, p, lam_f, lam, hv, hm, hw], [ca.triu(hessian)]),
        parameters=p.numel(),
        row_count=plain + slacks,
    )


def _symbols(shape: PathShape) -> _Symbols:
    n, lines, motion = shape.horizon, shape.lines, shape.motion
    q, s = ca.SX.sym("q", 2 * n), ca.SX.sym("s", shape.slacks)
    driving = ca.SX.sym("driving", shape.driven)
    head, line = ca.SX.sym("head", 5), ca.SX.sym("line", 4 * n * lines)
    own = ca.SX.sym("own", 0 if motion is None else motion.parameters)
    charge = ca.SX.sym("charge", PARAMETERS * int(shape.charged))
    plain, cost = path_rows(n, lines, q, head[0:2], line), ca.SX(0)
    if motion is not None:
        start = (head[0], head[1], *(own[i] for i in range(motion.rest)))
        all_lines = ca.vertcat(line, own[motion.rest :])
        plain = ca.vertcat(plain, *motion_rows(motion, q, driving, start, all_lines).stacked())
        if shape.charged:
            cost = goal_cost_s(motion, q, driving, start, charge)
    x, p = ca.vertcat(q, s, driving), ca.vertcat(head, line, own, charge)
    return _Symbols(s, head, x, p, plain, cost)


NEAR_START: dict[str, Any] = {
    "ipopt.mu_init": 1e-4,
    "ipopt.bound_push": 1e-3,
    "ipopt.bound_frac": 1e-3,
    "ipopt.slack_bound_push": 1e-3,
    "ipopt.slack_bound_frac": 1e-3,
    "ipopt.constr_mult_init_max": 0.0,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.min_refinement_steps": 0,
    "ipopt.fast_step_computation": "yes",
    "ipopt.max_soc": 0,
    "ipopt.alpha_red_factor": 0.3,
    "ipopt.mumps_permuting_scaling": 0,
    "ipopt.mumps_scaling": 0,
    "ipopt.max_iter": 80,
}
"""Starts are paths that keep all rows and lie near the best one: with IPOPT's own barrier, which
first drives the iterates to the middle, one long solve in ten does not return (40 steps). Least
squares for the first multipliers, scaling (the value comes scaled), refinement of well conditioned
steps and a look at their residuals cost a fifth of the time and gain nothing. Corrections of the
second order, and shorter steps in small stages, cost a fifth of the evaluations. The few solves
that need more than 30 iterations may gain most: half of the worth in one Munich-like scene of 20.
"""

DRIVEN: dict[str, Any] = {
    "ipopt.mu_init": 1e-2,
    "ipopt.max_iter": 100,
    "ipopt.max_soc": 4,
    "ipopt.alpha_red_factor": 0.5,
}
"""A start that follows a way is far from the best drive, and most of the gain comes late: plans of
harbour_track, 20 steps ahead, are worth a quarter more than with `NEAR_START` (8 seeds)."""

SETTLED: dict[str, Any] = {
    "ipopt.acceptable_iter": 1,
    "ipopt.acceptable_obj_change_tol": 1e-4,
    "ipopt.acceptable_constr_viol_tol": 1e-6,
    "ipopt.acceptable_tol": 1e6,
    "ipopt.acceptable_dual_inf_tol": 0.5,
    "ipopt.acceptable_compl_inf_tol": 0.5,
}
"""A path that keeps all rows and gained less than this share in an iteration is acceptable: what
is left is worth 0.05 % in the mean, and costs every third iteration. An iteration also gains little
where the line search has cut it short, at a gate of the measuring rule, say; multipliers are far
off there, and the solver goes on."""

DRIVEN_SETTLED: dict[str, Any] = SETTLED | {
    "ipopt.acceptable_iter": 2,
    "ipopt.acceptable_obj_change_tol": 3e-4,
}
"""A drive gains little in some single iterations far from the best."""


@dataclass(frozen=True)
class PathNlp:
    """A built solver."""

    shape: PathShape  # Its structure
    source: ValueSource  # Where its value and margins come from
    solver: Any  # The CasADi solver
    solve: SolveNlp  # One call of it, or of another method with its functions
    callbacks: tuple[PathCallbacks, ...]  # Kept so that they live as long as the solver


def build_path_nlp(
    shape: PathShape,
    method: Method = "ipopt",
    budget_s: float | None = None,
    until_settled: bool = False,
) -> PathNlp:
    """Build the programme.

    Parameters
    ----------
    shape
        Its structure.
    method
        Whose solver: IPOPT's, or sequential convex programming.
    budget_s
        Seconds after which a solve ends; None for no limit.
    until_settled
        Stop where the value has `SETTLED`, which need not be a point of KKT.
    """
    n = shape.horizon
    source = ValueSource()
    curved = curvature_size(n, shape.structure)
    value = path_callbacks("value", n, 1, curved, source.at)
    margins = path_callbacks("margin", n, n, 3 * n, source.margins_at) if shape.bounded else None
    total = path_callbacks("total", n, 1, 3 * n, source.total_at) if shape.summed else None

    parts = path_functions(shape)
    x, p = ca.MX.sym("x", shape.variables), ca.MX.sym("p", parts.parameters)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", parts.row_count)
    at, nothing = x[: 2 * n], (ca.MX(0, 1),) * 3
    v, dv, hv = value(at)
    m, dm, hm = nothing if margins is None else margins(at)
    w, dw, hw = nothing if total is None else total(at)
    nlp = ExactNlp(
        x,
        p,
        lam_f,
        lam_g,
        f=parts.objective(x, p, v),
        g=parts.rows(x, p, m, w),
        gradient=parts.gradient(x, p, dv),
        jacobian=parts.jacobian(x, p, dm, dw),
        hessian=parts.hessian(x, p, lam_f, lam_g, hv, hm, hw),
    )
    options, settled = OPTIONS | NEAR_START | time_limit(budget_s), SETTLED
    if shape.motion is not None:
        options, settled = options | DRIVEN, DRIVEN_SETTLED
    if until_settled:
        options |= settled
    solver = exact_solver("path", nlp, options)
    solve = solve_by(method, solver, shape, budget_s)
    kept = tuple(each for each in (value, margins, total) if each is not None)
    return PathNlp(shape, source, solver, solve, kept)


PIVOT_ROUNDING_M = 1e-2
"""Rounding of the distance to the pivot, so that its gradient exists at the pivot."""

REACH_OPTIONS: dict[str, Any] = {**ipopt.OPTIONS, "ipopt.tol": 1e-5, "ipopt.max_soc": 0}
"""No second order corrections: with them IPOPT cycled at the rounded kink of a pivot within reach
in 14 of 180 straight tasks, without in none, and elsewhere they gained nothing."""


@dataclass(frozen=True)
class ReachNlp:
    """A built solver."""

    horizon: int  # Its structure: N, and separating lines a segment
    lines: int
    source: MarginSource  # Where its margins come from
    solver: Any  # The CasADi solver
    solve: SolveNlp  # One call of it, or of another method with its functions
    callbacks: PathCallbacks  # Kept so that they live as long as the solver


STEP_ROUNDING_M = 1e-2
"""The same of a step's length, at a standstill."""

REACH_HEAD = 8
"""Parameters before those of each step: start (2), pivot (2), effort / h, rate, price, c_0."""


def _reach_objective(n: int, q: Any, score: Any, p: Any, charged: Any) -> Any:
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
    q, head, charged = ca.SX.sym("q", 2 * n), ca.SX.sym("head", REACH_HEAD), ca.SX.sym("charged", n)
    line = ca.SX.sym("line", 4 * n * lines)
    p_sx = ca.vertcat(head, charged, line)
    m_sx, dm_sx, hm_sx = (ca.SX.sym(f"m{width}", 2 * width * n) for width in (1, 2, 3))
    f_sx = _reach_objective(n, q, m_sx[n:], head, charged)
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
    solver = exact_solver("reach", nlp, REACH_OPTIONS | ipopt.time_limit(budget_s))
    shape = PathShape(n, lines, "stagewise", bounded=True, slacked=False)
    return ReachNlp(n, lines, source, solver, solve_by(method, solver, shape, budget_s), margins)
