# pyright: basic
"""Nonlinear programme over N steps, for any smooth objective of a path.

The variables are the positions q_1..q_N and a slack s_k of each stage's connectivity bound, or one
slack t of a total::

    max   scale * (value(q_1, ..., q_N) - cost) - slack_weight (sum s_k or t)
    s.t.  |q_k - q_{k-1}|^2 <= L^2                   k = 1..N             "speed"
          n_kj . q_k     >= b_kj                     k = 1..N, all j      "line_end"
          n_kj . q_{k-1} >= a_kj                     k = 2..N, all j      "line_start"
          margin_k(q_k) + s_k >= bound_k             k = 1..N             "connectivity"
          total(q_1, ..., q_N) + c t >= bound                             "connectivity"

L is the longest step. The separating lines (n, b, a) apply to both ends of a segment, so that the
whole segment is clear. A cost exists only for a robot with a goal. Value v, margins m, total w and
scores z are callbacks with exact gradients and the nonzero entries of their Hessians; margin
callbacks take a fifth of the time of their symbolic form. A solver is built once per structure and
reused.
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal

import casadi as ca
import numpy as np

from planopt.arrays import Floats
from planopt.objectives.terms.term import Structure
from planopt.planning.programme.goal_value import (
    PARAMETERS,
    ValueSource,
    goal_cost_s,
    priced_cost_s,
)
from planopt.planning.programme.solver import (
    OPTIONS,
    NlpFunctions,
    PathShape,
    SolveNlp,
    call_nlp,
    motion_rows,
    nlp_functions,
    path_rows,
)

Method = Literal["ipopt", "scp"]
"""Interior-point method, or sequential convex programming."""
METHODS: dict[str, Method] = {"auto": "ipopt", "nlp": "ipopt", "scp": "scp"}
"""Solution method of each planner that refines guesses."""
CURVATURE: dict[Structure, Callable[[int], int]] = {
    "stagewise": lambda n: 3 * n,
    "chain": lambda n: 7 * n - 4,
    "full": lambda n: 4 * n * n,
}
"""Number of stored Hessian entries of a value over N stages, by structure."""


class PathCallback(ca.Callback):
    """CasADi function that calls a NumPy function of the flattened positions (2 N,)."""

    def __init__(
        self, name: str, stages: int, size: int, evaluate: Callable[[Floats], Any]
    ) -> None:
        ca.Callback.__init__(self)
        self._sizes = 2 * stages, size
        self._evaluate = evaluate
        self.construct(name, {})

    def get_sparsity_in(self, _index: int) -> Any:
        """Return the sparsity of the argument, a dense vector of positions."""
        return ca.Sparsity.dense(self._sizes[0], 1)

    def get_sparsity_out(self, _index: int) -> Any:
        """Return the sparsity of the result, which is dense."""
        return ca.Sparsity.dense(self._sizes[1], 1)

    def has_eval_buffer(self) -> bool:
        """Return True, as buffers are ten times faster than CasADi matrices."""
        return True

    def eval_buffer(self, arguments: Any, results: Any) -> int:
        """Evaluate the NumPy function in the buffers; return 0 for success."""
        found = self._evaluate(np.frombuffer(arguments[0]))
        np.frombuffer(results[0])[:] = found if isinstance(found, float) else found.ravel()
        return 0


def path_callbacks(
    source: ValueSource, quantity: str, stages: int, sizes: dict[str, int]
) -> list[PathCallback]:
    """Return CasADi callbacks for parts of one quantity of an evaluation."""
    parts = {part: attrgetter(f"{quantity}.{part}") for part in sizes}
    return [
        PathCallback(f"{quantity}_{part}", stages, sizes[part], lambda at, of=of: of(source(at)))
        for part, of in parts.items()
    ]


def stage_blocks(entries: Any, n: int) -> Any:
    """Return a block-diagonal matrix of n symmetric 2 x 2 blocks, from entries xx, xy, yy."""
    blocks = [entries[3 * k : 3 * k + 3] for k in range(n)]
    return ca.diagcat(*[ca.vertcat(ca.horzcat(e[0], e[1]), ca.horzcat(e[1], e[2])) for e in blocks])


def curvature(entries: Any, n: int, structure: Structure) -> Any:
    """Return the Hessian matrix of a value from its stored nonzero entries."""
    if structure == "full":
        return ca.reshape(entries, 2 * n, 2 * n)
    found = stage_blocks(entries, n)
    if structure == "chain":
        for k in range(n - 1):
            at = 3 * n + 4 * k
            across = ca.vertcat(entries[at : at + 2].T, entries[at + 2 : at + 4].T)
            found[2 * k : 2 * k + 2, 2 * k + 2 : 2 * k + 4] = across
            found[2 * k + 2 : 2 * k + 4, 2 * k : 2 * k + 2] = across.T
    return found


@dataclass(frozen=True)
class PathNlp:
    """Solver of the nonlinear programme for one problem structure."""

    shape: PathShape
    source: ValueSource  # Source of its value and margins
    functions: NlpFunctions
    solve: SolveNlp
    callbacks: tuple[PathCallback, ...]  # Referenced so that they live as long as the solver


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
"""Options for guesses that satisfy all rows and lie near the optimum.

IPOPT's default barrier first moves the iterates to the interior; with it, one in ten long solves
(40 steps) does not return. Least-squares initial multipliers, scaling (the value is already
scaled), iterative refinement and its residual check take a fifth of the time without benefit.
Second-order corrections and smaller step reductions take a fifth of the evaluations. The few solves
that need more than 30 iterations may gain most."""

DRIVEN: dict[str, Any] = {
    "ipopt.mu_init": 1e-2,
    "ipopt.max_iter": 100,
    "ipopt.max_soc": 4,
    "ipopt.alpha_red_factor": 0.5,
}
"""Options for a robot with dynamics, whose guess is far from the optimum. 20-step plans of
harbour_track gain a quarter over `NEAR_START` (8 seeds)."""

SETTLED: dict[str, Any] = {
    "ipopt.acceptable_iter": 1,
    "ipopt.acceptable_obj_change_tol": 1e-4,
    "ipopt.acceptable_constr_viol_tol": 1e-6,
    "ipopt.acceptable_tol": 1e6,
    "ipopt.acceptable_dual_inf_tol": 0.5,
    "ipopt.acceptable_compl_inf_tol": 0.5,
}
"""Options that accept a feasible path once an iteration gains less than this fraction. They save a
third of the iterations and lose 0.05 % on average. After an iteration that the line search
shortened, the multipliers are inaccurate, so the solver continues."""

DRIVEN_SETTLED: dict[str, Any] = SETTLED | {
    "ipopt.acceptable_iter": 2,
    "ipopt.acceptable_obj_change_tol": 3e-4,
}
"""Options like `SETTLED` for robots with dynamics, whose early iterations may gain little."""


GOAL: dict[str, Any] = {"ipopt.tol": 1e-5, "ipopt.max_soc": 0}
"""Options for a goal cost. With second-order corrections, IPOPT cycled at the smoothed kink of a
reachable terminal waypoint in 14 of 180 straight tasks; without them, in none."""


def near_start(shape: PathShape, *, until_settled: bool = False) -> dict[str, Any]:
    """Return the solver options for refining a guess that is near the optimum."""
    # With `until_settled`, a solve ends once iterations gain little, possibly before a KKT point.
    settled = SETTLED if shape.motion is None else DRIVEN_SETTLED
    driven = {} if shape.motion is None else DRIVEN
    return NEAR_START | driven | (settled if until_settled else {})


def build_path_nlp(
    shape: PathShape,
    method: Method = "ipopt",
    budget_s: float | None = None,
    options: dict[str, Any] | None = None,
) -> PathNlp:
    """Return a solver of the nonlinear programme for one problem structure."""
    # `budget_s` and `options` are None for no limit and for the options of `near_start`.
    n, source = shape.horizon, ValueSource()
    value, rows = {"value": 1, "gradient": 2 * n}, {"rows": 6 * n}
    sizes = {
        "value": (shape.valued, value | {"hessian": CURVATURE[shape.structure](n)}),
        "margins": (shape.bounded, rows),
        "total": (shape.summed, value | {"hessian": 3 * n}),
        "scores": (shape.priced, rows),
    }
    callbacks = {
        name: path_callbacks(source, name, n, parts)
        for name, (is_used, parts) in sizes.items()
        if is_used
    }
    own = near_start(shape) if options is None else options
    limit = {} if budget_s is None else {"ipopt.max_wall_time": budget_s}
    solver = _exact_solver(shape, callbacks, OPTIONS | own | limit)
    functions = nlp_functions(solver)
    kept = tuple(each for parts in callbacks.values() for each in parts)
    if method == "scp":
        # Imported here because only this planner needs Clarabel.
        from planopt.planning.programme.scp import scp_solve

        return PathNlp(shape, source, functions, scp_solve(functions, shape, budget_s), kept)
    return PathNlp(shape, source, functions, lambda *given: call_nlp(solver, n, *given), kept)


def _slopes(rows: Any, n: int, others: int) -> Any:
    """Return the Jacobian of n stages by all variables, from their rows of derivatives."""
    if not rows.numel():
        return ca.SX(0, 2 * n + others)
    each = [ca.horzcat(rows[6 * k + 1], rows[6 * k + 2]) for k in range(n)]
    return ca.horzcat(ca.diagcat(*each), ca.SX(n, others))


def _exact_solver(
    shape: PathShape, callbacks: dict[str, list[PathCallback]], options: dict[str, Any]
) -> Any:
    """Return an IPOPT solver with exact derivatives, also of the callbacks."""
    n, slacks, driven, motion = shape.horizon, shape.slacks, shape.driven, shape.motion
    q, s = ca.SX.sym("q", 2 * n), ca.SX.sym("s", slacks)
    driving = ca.SX.sym("driving", driven)
    head, line = ca.SX.sym("head", 5), ca.SX.sym("line", 4 * n * shape.lines)
    own = ca.SX.sym("own", 0 if motion is None else motion.parameters)
    charge = ca.SX.sym("charge", (6 + n if motion is None else PARAMETERS) * int(shape.charged))
    x, p = ca.vertcat(q, s, driving), ca.vertcat(head, line, own, charge)
    plain, cost = path_rows(n, shape.lines, q, head[0:2], line), ca.SX(0)
    if motion is not None:
        start = (head[0], head[1], *(own[i] for i in range(motion.rest)))
        every = ca.vertcat(line, own[motion.rest :])
        plain = ca.vertcat(plain, *motion_rows(motion, q, driving, start, every).stacked())
        if shape.charged:
            cost = goal_cost_s(motion, q, driving, start, charge)

    curved, count = CURVATURE[shape.structure](n) * int(shape.valued), plain.numel()
    v, dv, hv = (ca.SX.sym(f"v{size}", size * int(shape.valued)) for size in (1, 2 * n, curved))
    m, z = ca.SX.sym("m", 6 * n * int(shape.bounded)), ca.SX.sym("z", 6 * n * int(shape.priced))
    w, dw, hw = (ca.SX.sym(f"w{size}", size * int(shape.summed)) for size in (1, 2 * n, 3 * n))
    lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", count + shape.bounds)
    others = ca.SX(slacks + driven, slacks + driven)
    if shape.priced:
        cost = priced_cost_s(n, q, z[::6], head[0:2], charge)
    # By the chain rule, as the cost depends on the positions through the scores too.
    both = ca.vertcat(x, z[::6])
    through = ca.vertcat(ca.SX.eye(x.numel()), _slopes(z, n, slacks + driven))
    slope = ca.gradient(cost, both)
    bend = ca.hessian(lam_f * head[2] * cost + ca.dot(lam[:count], plain), both)[0]
    # The solver minimises.
    objective = head[2] * cost + head[3] * ca.sum1(s)
    gradient = ca.vertcat(ca.SX(2 * n, 1), head[3] * ca.SX.ones(slacks), ca.SX(driven, 1))
    gradient += head[2] * (through.T @ slope)
    gradient, hessian = ca.densify(gradient), through.T @ bend @ through
    if shape.valued:
        objective -= head[2] * v
        gradient -= head[2] * ca.vertcat(dv, ca.SX(slacks + driven, 1))
        hessian -= lam_f * head[2] * ca.diagcat(curvature(hv, n, shape.structure), others)
    rows, jacobian = plain, ca.jacobian(plain, x)
    for each, by in (m, lam[count:]), (z, lam_f * head[2] * slope[x.numel() :]):
        if each.numel():
            weighted = [by[k] * each[6 * k + 3 + j] for k in range(n) for j in range(3)]
            hessian += ca.diagcat(stage_blocks(ca.vertcat(*weighted), n), others)
    if shape.bounded:
        rows = ca.vertcat(rows, m[::6] + s if shape.slacked else m[::6])
        slack = ca.vertcat(ca.SX(2 * n, n), ca.SX.eye(n)[:slacks, :], ca.SX(driven, n)).T
        jacobian = ca.vertcat(jacobian, _slopes(m, n, slacks + driven) + slack)
    if shape.summed:
        hessian += ca.diagcat(stage_blocks(lam[count] * hw, n), others)
        rows = ca.vertcat(rows, w + head[4] * s)
        jacobian = ca.vertcat(jacobian, ca.horzcat(dw.T, head[4], ca.SX(1, driven)))

    X, P = ca.MX.sym("x", shape.variables), ca.MX.sym("p", p.numel())
    at, nothing = X[: 2 * n], (ca.MX(0, 1),) * 3
    V, M, W, Z = (
        [each(at) for each in callbacks[name]] if name in callbacks else nothing
        for name in ("value", "margins", "total", "scores")
    )
    f = ca.Function("f", [x, p, v, z], [objective])(X, P, V[0], Z[0])
    g = ca.Function("g", [x, p, m, w], [rows])(X, P, M[0], W[0])
    df = ca.Function("df", [x, p, dv, z], [gradient])(X, P, V[1], Z[0])
    dg = ca.Function("dg", [x, p, m, dw], [jacobian])(X, P, M[0], W[1])
    by_f, by_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", lam.numel())
    upper = ca.Function("h", [x, p, lam_f, lam, hv, m, hw, z], [ca.triu(hessian)])
    h = upper(X, P, by_f, by_g, V[2], M[0], W[2], Z[0])
    # The solver uses only the derivatives of these two functions, so they return no values.
    no_f, no_g = ca.MX.nan(1), ca.MX.nan(g.numel())
    derivatives = {
        "grad_f": ca.Function("nlp_grad_f", [X, P], [no_f, df], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("nlp_jac_g", [X, P], [no_g, dg], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function(
            "nlp_hess_l",
            [X, P, by_f, by_g],
            [h],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        ),
    }
    return ca.nlpsol("path", "ipopt", {"x": X, "p": P, "f": f, "g": g}, options | derivatives)
