# pyright: basic
"""Rows that every programme over a path has.

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


def path_rows(n: int, lines: int, q: Any, start: Any, line: Any) -> Any:
    """Stack the rows, in the order of the module's docstring.

    Parameters
    ----------
    n, lines
        N, and separating lines a segment.
    q, start
        CasADi expressions: positions (2 N,) and where the robot is (2,).
    line
        (4 N lines,) normals, offsets at the end and at the start, by segment and line.
    """
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
