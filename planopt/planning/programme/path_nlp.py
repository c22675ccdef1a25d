# pyright: basic
"""The nonlinear programme over N steps, for any smooth value of a path.

Variables are the positions q_1..q_N, with a slack s_k of each stage's connectivity bound::

    max   scale * value(q_1, ..., q_N) - slack_weight sum s_k
    s.t.  the rows of planopt.planning.programme.path_rows
          margin_k(q_k) + s_k >= bound_k             k = 1..N             "connectivity"
          total(q_1, ..., q_N) + c t >= bound                             "connectivity"

There are rows of margins, one of a total (a sum over stages), or none. The total's slack t is in dB
like the others, c is the change of the total per dB. A programme without slacks keeps its bounds.
The cost of a goal is a value like any other (:mod:`planopt.planning.programme.goal_value`); that of
a robot with dynamics is symbolic and subtracted here.

Value v, margins m and total w come by callbacks
(:mod:`planopt.planning.programme.margin_source`) with exact gradients (dv, dm, dw) and what is not
zero of their Hessians (hv, hm, hw): margins by callbacks take a fifth of the time of their symbolic
form. All else is symbolic.
What the value couples (:data:`planopt.planning.programme.margin_source.Structure`) is known to the
solver. The parameters are ``head`` (start, scale, slack weight, what a dB is
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

from planopt.planning.programme.goal_value import PARAMETERS, goal_cost_s
from planopt.planning.programme.ipopt import OPTIONS, ExactNlp, exact_solver, time_limit
from planopt.planning.programme.margin_source import ValueSource
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
    lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", plain + shape.bounds)
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
        rows = ca.vertcat(rows, m + at.s if shape.slacked else m)
        slopes = ca.horzcat(stage_rows(dm, n), ca.SX.eye(n)[:, :slacks], ca.SX(n, driven))
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
        row_count=plain + shape.bounds,
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


GOAL: dict[str, Any] = {"ipopt.tol": 1e-5, "ipopt.max_soc": 0}
"""For the cost of a goal. No second order corrections: with them IPOPT cycled at the rounded kink
of a pivot within reach in 14 of 180 straight tasks, without in none, and elsewhere they gained
nothing."""


def near_start(shape: PathShape, *, until_settled: bool = False) -> dict[str, Any]:
    """Return the options for refining a guess near the best path.

    A solve ends where the value has `SETTLED`, which need not be a KKT point, if `until_settled`.
    """
    settled = SETTLED if shape.motion is None else DRIVEN_SETTLED
    driven = {} if shape.motion is None else DRIVEN
    return NEAR_START | driven | (settled if until_settled else {})


def build_path_nlp(
    shape: PathShape,
    method: Method = "ipopt",
    budget_s: float | None = None,
    options: dict[str, Any] | None = None,
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
    options
        Options of IPOPT; None for those of :func:`near_start`.
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
    own = near_start(shape) if options is None else options
    solver = exact_solver("path", nlp, OPTIONS | own | time_limit(budget_s))
    solve = solve_by(method, solver, shape, budget_s)
    kept = tuple(each for each in (value, margins, total) if each is not None)
    return PathNlp(shape, source, solver, solve, kept)
