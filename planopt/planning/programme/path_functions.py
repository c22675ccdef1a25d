# pyright: basic
"""The programme over a path as CasADi functions of what its callbacks give.

Value v, margins m and total w come with their gradients (dv, dm, dw) and what is not zero of their
Hessians (hv, hm, hw); all else is symbolic. Parameters are ``head`` (start, scale, slack weight,
what a dB is worth in the total), the lines, and those of the robot's dynamics and its goal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from planopt.planning.programme.curvature import (
    curvature,
    curvature_size,
    stage_blocks,
    stage_rows,
    weighted_blocks,
)
from planopt.planning.programme.goal_cost import PARAMETERS, goal_cost_s
from planopt.planning.programme.motion_rows import motion_rows
from planopt.planning.programme.path_rows import path_rows
from planopt.planning.programme.path_shape import PathShape


@dataclass(frozen=True)
class PathFunctions:
    """Functions of variables x, parameters p and what the callbacks give.

    Attributes
    ----------
    objective, gradient
        ``(x, p, v)`` to the objective (minimised), ``(x, p, dv)`` to its gradient.
    rows, jacobian
        ``(x, p, m, w)`` to all rows, ``(x, p, dm, dw)`` to their Jacobian.
    hessian
        ``(x, p, lam_f, lam_g, hv, hm, hw)`` to the upper triangle of the Lagrangian's Hessian.
    parameters, row_count
        How many there are.
    """

    objective: Any
    gradient: Any
    rows: Any
    jacobian: Any
    hessian: Any
    parameters: int
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
