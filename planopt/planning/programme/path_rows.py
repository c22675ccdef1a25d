# pyright: basic
"""Rows that every programme over a path has, and its derivatives as CasADi matrices.

With L the longest step and (n, b, a) separating lines, fixed from the start path and applied to
both ends of a segment, so that the whole segment is clear::

    |q_k - q_{k-1}|^2 <= L^2       k = 1..N            "speed"
    n_kj . q_k     >= b_kj         k = 1..N, all j     "line_end"
    n_kj . q_{k-1} >= a_kj         k = 2..N, all j     "line_start"

b and a are equal where the line keeps from an obstacle; a line that keeps from something that moves
has one offset at the step's end and another at its begin.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from planopt.objectives.terms.term import Structure


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
