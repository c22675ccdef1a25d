# pyright: basic
"""The nonlinear programme over N steps, for any smooth value of a path.

Variables are the positions q_1..q_N, with a slack s_k of each stage's connectivity bound::

    max   scale * value(q_1, ..., q_N) - slack_weight sum s_k
    s.t.  |q_k - q_{k-1}|^2 <= L^2                   k = 1..N             "speed"
          n_kj . q_k     >= b_kj                     k = 1..N, all j      "line_end"
          n_kj . q_{k-1} >= a_kj                     k = 2..N, all j      "line_start"
          margin_k(q_k) + s_k >= bound_k             k = 1..N             "connectivity"
          total(q_1, ..., q_N) + c t >= bound                             "connectivity"

L is the longest step. The separating lines (n, b, a) are fixed from the initial guess and applied
to both ends of a segment, so that the whole segment is clear; b and a are equal for an obstacle,
and differ for one that moves. There are rows of margins, one of a total (a sum over stages), or
none. The total's slack t is in dB like the others, c is the change of the total per dB. A programme
without slacks keeps its bounds.
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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.objectives.terms.term import Structure
from planopt.planning.programme.goal_value import PARAMETERS, goal_cost_s
from planopt.planning.programme.ipopt import (
    OPTIONS,
    ExactNlp,
    exact_solver,
    ipopt_solve,
    time_limit,
)
from planopt.planning.programme.margin_source import ValueSource
from planopt.planning.programme.motion_rows import motion_rows
from planopt.planning.programme.nlp_functions import SolveNlp
from planopt.planning.programme.path_shape import PathShape

Method = Literal["ipopt", "scp"]
"""Interior points, or sequential convex programming."""

METHODS: dict[str, Method] = {"auto": "ipopt", "nlp": "ipopt", "scp": "scp"}
"""Of the planners that refine; the others do not."""


def solve_by(
    method: Method, solver: Any, shape: PathShape, budget_s: float | None = None
) -> SolveNlp:
    """Solve a programme over a path of a shape, built as a CasADi `solver`, by a method.

    A solve ends after `budget_s` seconds, if that is given; IPOPT has that among its options.
    """
    if method == "ipopt":
        return ipopt_solve(solver, shape.horizon)
    # Not needed by those who never ask for it.
    from planopt.planning.programme.nlp_functions import nlp_functions
    from planopt.planning.programme.scp import motion_cones, scp_solve, step_cones

    motion, n = shape.motion, shape.horizon
    cones = step_cones(n) if motion is None else motion_cones(shape)
    longest = None if motion is None else motion.dynamics.speed_max_m_s * motion.step_s
    return scp_solve(nlp_functions(solver), n, cones, shape.per_m, longest, budget_s)


def curvature_size(n: int, structure: Structure) -> int:
    """Return how many numbers the Hessian of a value over N = `n` stages has."""
    return {"stagewise": 3 * n, "chain": 7 * n - 4, "full": 4 * n * n}[structure]


def curvature(entries: Any, n: int, structure: Structure) -> Any:
    """Hessian of a value from the numbers of a `PathValue`."""
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


def stage_blocks(entries: Any, n: int) -> Any:
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


def weighted_blocks(multipliers: Any, entries: Any, n: int) -> Any:
    """Hessian of the stages' margins, each by its row's multiplier."""
    weighted = [multipliers[k] * entries[3 * k + j] for k in range(n) for j in range(3)]
    return stage_blocks(ca.vertcat(*weighted), n)


def stage_rows(gradients: Any, n: int) -> Any:
    """Jacobian (N, 2 N) of the stages' margins, each of its own place alone."""
    return ca.diagcat(*[gradients[2 * k : 2 * k + 2].T for k in range(n)])


def path_rows(n: int, lines: int, q: Any, start: Any, line: Any) -> Any:
    """Stack the rows, in the order of the module's docstring."""
    speed, line_end, line_start = [], [], []
    for k in range(n):
        here = q[2 * k : 2 * k + 2]
        before = start if k == 0 else q[2 * k - 2 : 2 * k]
        speed.append(ca.sumsqr(here - before))
        for j in range(lines):
            at = 4 * (k * lines + j)
            line_end.append(line[at] * here[0] + line[at + 1] * here[1] - line[at + 2])
            if k > 0:
                line_start.append(line[at] * before[0] + line[at + 1] * before[1] - line[at + 3])
    return ca.vertcat(*speed, *line_end, *line_start)


class PathCallback(ca.Callback):
    """A NumPy function of the flattened positions (2 N,) as a CasADi function."""

    def __init__(
        self,
        name: str,
        stages: int,
        size: int,
        evaluate: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    ) -> None:
        ca.Callback.__init__(self)
        self._stages = stages
        self._size = size
        self._evaluate = evaluate
        self.construct(name, {})

    def get_n_in(self) -> int:
        """One input."""
        return 1

    def get_n_out(self) -> int:
        """One output."""
        return 1

    def get_sparsity_in(self, _index: int) -> Any:
        """The positions, dense."""
        return ca.Sparsity.dense(2 * self._stages, 1)

    def get_sparsity_out(self, _index: int) -> Any:
        """The numbers, dense."""
        return ca.Sparsity.dense(self._size, 1)

    def has_eval_buffer(self) -> bool:
        """Numbers are read and written in place: ten times faster than as CasADi matrices."""
        return True

    def eval_buffer(self, arguments: Any, results: Any) -> int:
        """Ask the NumPy function."""
        numbers = np.frombuffer(results[0])
        numbers[:] = self._evaluate(np.frombuffer(arguments[0])).ravel()
        return 0


class Differentiated(Protocol):
    """A value, or one of each stage, with derivatives by the positions."""

    @property
    def value(self) -> float | NDArray[np.float64]:
        """The value, or ``(N,)``."""
        ...

    @property
    def gradient(self) -> NDArray[np.float64]:
        """``(N, 2)``."""
        ...

    @property
    def hessian(self) -> NDArray[np.float64]:
        """Return the numbers of the Hessian that are not zero."""
        ...


@dataclass(frozen=True)
class PathCallbacks:
    """The callbacks of one quantity."""

    value: PathCallback
    gradient: PathCallback
    hessian: PathCallback

    def __call__(self, at: Any) -> tuple[Any, Any, Any]:
        """Value, gradient and Hessian at positions (2 N,), a CasADi expression."""
        return self.value(at), self.gradient(at), self.hessian(at)


def path_callbacks(
    name: str,
    stages: int,
    values: int,
    curved: int,
    evaluate: Callable[[NDArray[np.float64]], Differentiated],
) -> PathCallbacks:
    """Callbacks of one quantity."""
    return PathCallbacks(
        PathCallback(name, stages, values, lambda at: np.asarray(evaluate(at).value)),
        PathCallback(
            f"{name}_gradient", stages, 2 * max(values, stages), lambda at: evaluate(at).gradient
        ),
        PathCallback(f"{name}_hessian", stages, curved, lambda at: evaluate(at).hessian),
    )


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
